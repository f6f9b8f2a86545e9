"""A discrete state space as source code: a function in C, and a program in Python for scipy."""

from __future__ import annotations

import keyword
import re
from collections.abc import Sequence

import control as ct
import numpy as np

from .. import _checks
from .._display import counted
from .._types import Array
from ..exceptions import StructureError
from ..systems.base import Convertible

# what C keeps to itself, besides what Python does; `name` stands in names of functions and macros
_C_WORDS = frozenset(
    "auto break case char const continue default do double else enum extern float for goto if inline int long register "
    "restrict return short signed sizeof static struct switch typedef union unsigned void volatile while main".split()
)
_C_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,40}")
_ACROSS = 3  # numbers in a line

_C_CODE = """\
/* {title}
 *
 * Call {name}_step once in each period of {period}:
 *     y = C x + D u;   x = A x + B u
 * x[{states}] is the state, 0 at the start; u[{inputs}] are the inputs and y[{outputs}] the outputs of this sample.
 * x, u and y are different arrays. Inputs:{input_names}. Outputs:{output_names}.
 */
#ifndef {macro}_REAL
#define {macro}_REAL double /* float: compile with -D{macro}_REAL=float */
#endif
#define {macro}_STATES {states}
#define {macro}_INPUTS {inputs}
#define {macro}_OUTPUTS {outputs}

static const {macro}_REAL {name}_output_matrix[{outputs}][{columns}] = {{ /* C, D */
{output_rows}
}};
{state_table}
void {name}_step({macro}_REAL *x, const {macro}_REAL *u, {macro}_REAL *y)
{{
    int i, j;
{body}}}
"""

_OUTPUT_LOOP = """\
    for (i = 0; i < {outputs}; i++) {{
        {macro}_REAL sum = 0;
        for (j = 0; j < {states}; j++) sum += {name}_output_matrix[i][j] * x[j];
        for (j = 0; j < {inputs}; j++) sum += {name}_output_matrix[i][{states} + j] * u[j];
        y[i] = sum;
    }}
"""
_STATE_LOOP = """\
    for (i = 0; i < {states}; i++) {{
        {macro}_REAL sum = 0;
        for (j = 0; j < {states}; j++) sum += {name}_state_matrix[i][j] * x[j];
        for (j = 0; j < {inputs}; j++) sum += {name}_state_matrix[i][{states} + j] * u[j];
        next[i] = sum;
    }}
    for (i = 0; i < {states}; i++) x[i] = next[i];
"""


def to_c(sys: ct.StateSpace, name: str = "plant") -> str:
    """Source code in C of a discrete state space: a function that makes one step.

    Parameters
    ----------
    sys : control.StateSpace
        System of discrete time, as `sample`, `control.sample_system` or `lqg(..)` with `sample` give it.
    name : str
        Name in C: the function is `<name>_step(x, u, y)`, the numbers of states, inputs and outputs are macros.

    Returns
    -------
    str
        Text in C89, without a library, memory of its own or a state between calls.

    Raises
    ------
    StructureError
        If the system is none of discrete time with a known step, its matrices are not finite, or the name is none in C.

    See Also
    --------
    to_python : the same for scipy.

    Notes
    -----
    `y_k = C x_k + D u_k`, `x_(k+1) = A x_k + B u_k`.  Numbers have all their digits.  ``-DPLANT_REAL=float`` makes all
    of it single precision; then take a system in coordinates of one size, such as modal ones.  A step is
    `(n + p) (n + m)` multiplications.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> oscillator = phc.sample(phc.ph(np.eye(2), [0.0, 1.0]), 0.1)
    >>> code = phc.to_c(oscillator, "oscillator")
    >>> print(code.splitlines()[0])
    /* oscillator: 2 states, 1 input, 1 output
    >>> [line for line in code.splitlines() if line.startswith("void")]
    ['void oscillator_step(OSCILLATOR_REAL *x, const OSCILLATOR_REAL *u, OSCILLATOR_REAL *y)']
    """
    plant = _checked(sys)
    if not isinstance(name, str) or not _C_NAME.fullmatch(name) or name in _C_WORDS:
        raise StructureError(
            f"name is {_checks.shown(name)}; a name in C has letters, digits and _, at most 41, begins with a letter, "
            "and is no word of the language"
        )
    n, m, p = plant.nstates, plant.ninputs, plant.noutputs
    words = {"name": name, "macro": name.upper(), "states": n, "inputs": m, "outputs": p, "columns": n + m}
    table, body = "", _OUTPUT_LOOP.format(**words)
    if n:
        rows = _c_rows(np.hstack([plant.A, plant.B]))
        table = "static const {macro}_REAL {name}_state_matrix[{states}][{columns}] = {{ /* A, B */\n".format(**words)
        table += rows + "\n};\n"
        body = f"    {name.upper()}_REAL next[{n}];\n" + body + _STATE_LOOP.format(**words)
    else:
        body = "    (void)x;\n" + body
    sizes = (counted(number, noun) for number, noun in ((n, "state"), (m, "input"), (p, "output")))
    unit = getattr(sys, "time_unit", None)
    return _C_CODE.format(
        **words, title=f"{name}: {', '.join(sizes)}",
        period=f"{float(plant.dt)!r} " + (_in_comment(unit) if unit else "(in the unit of time of the system)"),
        input_names=_names(plant.input_labels), output_names=_names(plant.output_labels),
        output_rows=_c_rows(np.hstack([plant.C, plant.D])), state_table=table, body=body,
    )  # fmt: skip


def to_python(sys: ct.StateSpace, name: str = "plant") -> str:
    """Source code in Python of a discrete state space for `scipy.signal`, without this package.

    Parameters
    ----------
    sys : control.StateSpace
        System of discrete time.
    name : str
        Name of the `scipy.signal.StateSpace` that the code makes.

    Returns
    -------
    str
        Text of a program; `scipy.signal.dlsim(plant, u)` simulates what it makes.

    Raises
    ------
    StructureError
        If the system is none of discrete time with a known step, its matrices are not finite, or the name is none in
        Python.

    See Also
    --------
    to_c : the same in C.

    Notes
    -----
    The matrices come back bit by bit.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> code = phc.to_python(phc.sample(phc.ph(np.eye(2), [0.0, 1.0]), 0.1), "oscillator")
    >>> made = {}
    >>> exec(code, made)
    >>> made["oscillator"].dt, made["oscillator"].A.shape
    (0.1, (2, 2))
    """
    plant = _checked(sys)
    if not isinstance(name, str) or not name.isidentifier() or keyword.iskeyword(name) or name in ("np", "signal"):
        raise StructureError(
            f"name is {_checks.shown(name)}; it must be a name in Python, other than np and signal, which are imported"
        )
    matrices = [
        f"{letter} = np.array({_python_rows(matrix)}).reshape{matrix.shape}"
        for letter, matrix in (("A", plant.A), ("B", plant.B), ("C", plant.C), ("D", plant.D))
    ]
    inputs, outputs = _names(plant.input_labels), _names(plant.output_labels)
    head = [
        f"# {name}: inputs{inputs}; outputs{outputs}",
        "import numpy as np", "from scipy import signal", "",
    ]  # fmt: skip
    foot = [f"{name} = signal.StateSpace(A, B, C, D, dt={float(plant.dt)!r})", ""]
    return "\n".join([*head, *matrices, *foot])


def _checked(sys: Convertible) -> ct.StateSpace:
    """Refuse all but a state space of discrete time with numbers in it."""
    if not isinstance(sys, ct.StateSpace) or sys.isctime(strict=False) or isinstance(sys.dt, bool) or not sys.dt:
        raise StructureError(
            f"the system is a {type(sys).__name__} with dt={getattr(sys, 'dt', None)!r}; it must be a "
            "control.StateSpace of discrete time with a step: sample it by sample(sys, h), or "
            "control.sample_system(control.ss(sys), h)"
        )
    for letter in "ABCD":
        _checks.finite(f"the matrix {letter}", np.asarray(getattr(sys, letter), float))
    if not sys.noutputs or not sys.ninputs:
        raise StructureError(f"the system has {sys.ninputs} inputs and {sys.noutputs} outputs; one of each is needed")
    return sys


def _c_rows(matrix: Array) -> str:
    rows = []
    for row in np.asarray(matrix, float):
        numbers = [repr(float(value)) for value in row]
        lines = [", ".join(numbers[k : k + _ACROSS]) for k in range(0, len(numbers), _ACROSS)]
        rows.append("    {" + ",\n     ".join(lines) + "}")
    return ",\n".join(rows)


def _python_rows(matrix: Array) -> str:
    rows = [", ".join(repr(float(value)) for value in row) for row in np.asarray(matrix, float)]
    return "[\n" + "".join(f"    [{row}],\n" for row in rows) + "]" if rows else "[]"


def _names(labels: Sequence[str]) -> str:
    return " " + _in_comment(", ".join(map(str, labels)))


def _in_comment(text: object) -> str:
    """Text on a line, which does not end a comment in C."""
    return " ".join(str(text).split()).replace("*/", "* /").replace("/*", "/ *").replace("\\", "/").replace("??", "? ?")
