"""A netlist: elements between nodes, the sources that are its ports, and its text in SPICE."""

from __future__ import annotations

import os
from dataclasses import dataclass

from .._frozen import Frozen
from ..io.files import as_path, write_atomically


@dataclass(frozen=True)
class Element:
    """One element of a netlist.

    Attributes
    ----------
    name : str
        Its first letter says what it is: `R`, `L`, `C`, `K` (coupling of two inductors), `V`, `I` (sources), `E`, `F`,
        `G` (controlled sources).
    nodes : tuple of str
        Nodes; of `K` the inductors, of `E` and `G` also the controlling nodes, of `F` also the controlling source.
    value : float
        Ohm, henry, farad; coupling coefficient, gain; of a source 0.
    stderr : float or None
        Standard error of the value, of a circuit of a fit; NaN where the data do not tell it.
    """

    name: str
    nodes: tuple[str, ...]
    value: float
    stderr: float | None = None

    @property
    def letter(self) -> str:
        """Kind of element: the first letter of the name, capital."""
        return self.name[0].upper()


@dataclass(frozen=True, eq=False)
class Netlist(Frozen):
    """A circuit with the transfer function of a system; made by `netlist`.

    Attributes
    ----------
    elements : tuple of Element
        With `name`, `nodes` and `value`; node `0` is ground.
    ports : tuple of Element
        Sources at the ports, in the order of the inputs: voltage sources of an admittance, current sources of an
        impedance.
    form : str
        'foster1', 'foster2', 'cauer1', 'cauer2' or 'state-space'.
    kind : str
        'admittance' or 'impedance': what the transfer function of the system is.
    title : str
        First line of the text.

    See Also
    --------
    netlist, read_netlist

    Examples
    --------
    >>> import ph_control as phc
    >>> circuit = phc.netlist(phc.modes([2.0], [1.0]))
    >>> [(element.name, element.nodes, element.value) for element in circuit.elements]
    [('L1', ('1', '2'), 0.5), ('C1', ('2', '0'), 0.5)]
    """

    elements: tuple[Element, ...]
    ports: tuple[Element, ...]
    form: str
    kind: str
    title: str

    def __repr__(self) -> str:
        return f"<Netlist: {self.form} of an {self.kind}, {len(self.elements)} elements, {len(self.ports)} port(s)>"

    def spice(self) -> str:
        """Text of the netlist, as SPICE programs read it.

        Returns
        -------
        str
            Values with all their digits.  The sources have the amplitude 1 in an analysis `.ac`, a line that you add
            before `.end`: with a voltage source the admittance is the current `-i(V1)`, with a current source the
            impedance is the voltage `v(1)`.

        Notes
        -----
        The option `noopac` leaves out the operating point: with a constant source a circuit without losses has none.

        Examples
        --------
        >>> import ph_control as phc
        >>> print(phc.netlist(phc.modes([2.0], [1.0])).spice())
        Foster II form of an admittance
        V1 1 0 DC 0 AC 1
        L1 1 2 0.5
        C1 2 0 0.5
        .options noopac
        .end
        """
        sources = [f"{port.name} {' '.join(port.nodes)} DC 0 AC 1" for port in self.ports]
        lines = [f"{element.name} {' '.join(element.nodes)} {element.value!r}" for element in self.elements]
        return "\n".join([self.title, *sources, *lines, ".options noopac", ".end", ""])

    def save(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the text to a file.

        Parameters
        ----------
        path : str or path-like
            Name of the file.
        overwrite : bool
            Whether to replace a file of that name.

        Raises
        ------
        OutputExistsError
            If the file exists, and `overwrite` is not set.
        FileMissingError
            If there is no such folder.

        Examples
        --------
        >>> import pathlib, tempfile, ph_control as phc
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "resonator.cir"
        >>> phc.netlist(phc.modes([2.0], [1.0])).save(path)
        >>> phc.read_netlist(path).natural_frequencies
        array([2.])
        """
        write_atomically(as_path(path), self.spice(), overwrite=overwrite)
