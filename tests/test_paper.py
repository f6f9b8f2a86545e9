"""The table of docs/paper.md: every item of the paper has a row, and every row a function and a test that exist."""

import ast
import functools
import inspect
import re
from pathlib import Path

import pytest

import ph_control as phc

TESTS = Path(__file__).resolve().parent
PAGE = (TESTS.parent / "docs" / "paper.md").read_text(encoding="utf-8")

# what one counter in each section numbers, and what one counter through the paper numbers
NUMBERED = {2: 4, 3: 10, 4: 20, 5: 4, 6: 1, 9: 1}
EQUATIONS = 32
ITEM = re.compile(r"(?:Theorem|Proposition|Lemma|Definition|Example|Remark) (\d+)\.(\d+)")
STATUS = re.compile(r"(as printed|corrected \((?:10|[1-9])\))(, note \([a-e]\))?")


def rows():
    """Cells of every row, without heads and rules."""
    lines = [line for line in PAGE.splitlines() if line.startswith("| ") and not line.startswith("| item ")]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]


ROWS = rows()


def resolve(name):
    """Attribute of the package, or of one of its modules, at the end of a dotted name."""
    return functools.reduce(getattr, name.split("."), phc)


@functools.cache
def defined_in(file):
    tree = ast.parse((TESTS / file).read_text(encoding="utf-8"))
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


def test_every_row_has_five_cells_and_says_whether_the_paper_is_right():
    assert len(ROWS) > 80
    assert [row for row in ROWS if len(row) != 5 or not all(row)] == []
    assert [row[0] for row in ROWS if not STATUS.fullmatch(row[4])] == []


def test_every_numbered_item_and_equation_of_the_paper_has_a_row():
    found = {(int(section), int(number)) for row in ROWS for section, number in ITEM.findall(row[0])}
    assert found == {(section, k) for section, count in NUMBERED.items() for k in range(1, count + 1)}
    equations = {int(number) for row in ROWS for number in re.findall(r"\((\d+)\)", row[0])}
    assert equations == set(range(1, EQUATIONS + 1))


def test_the_numbers_are_those_that_the_source_of_the_paper_gives(data_folder):
    paper = data_folder.parent / "paper" / "learnability-of-linear-port-hamiltonian-systems.tex"
    if not paper.is_file():
        pytest.skip(f"the source of the paper is not at {paper}")
    text = re.sub(r"(?<!\\)%.*", "", paper.read_text(encoding="utf-8"))
    section, counts, equations = 0, {}, 0
    kinds = r"\\section\{|\\begin\{(theorem|proposition|lemma|definition|example|remark|equation|align|multline)\}"
    for match in re.finditer(kinds, text):
        if match[1] is None:
            section += 1
        elif match[1] in ("equation", "align", "multline"):
            equations += 1  # each align of the paper numbers one of its lines
        else:
            counts[section] = counts.get(section, 0) + 1
    assert (counts, equations) == (NUMBERED, EQUATIONS)


@pytest.mark.variants
@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_every_function_and_every_test_of_a_row_exists(row):
    names = re.findall(r"`([^`]+)`", row[2])
    assert names and re.sub(r"`[^`]+`|, ", "", row[2]) == ""
    for name in names:
        found = resolve(name)
        assert callable(found) or isinstance(found, property) or inspect.isdatadescriptor(found), name
    references = re.findall(r"`(test_\w+\.py)::(test_\w+)`", row[3])
    assert references and re.sub(r"`[^`]+`|, ", "", row[3]) == ""
    assert [test for file, test in references if test not in defined_in(file)] == []


def test_every_test_named_outside_the_table_exists_too():
    assert [
        test for file, test in re.findall(r"`(test_\w+\.py)::(test_\w+)`", PAGE) if test not in defined_in(file)
    ] == []


def test_every_correction_and_note_has_its_section_and_is_used_and_has_its_test():
    sections = re.findall(r"^### \((\d+)\)", PAGE, flags=re.M)
    used = {number for row in ROWS for number in re.findall(r"corrected \((\d+)\)", row[4])}
    assert sections == [str(k) for k in range(1, 11)] and used == set(sections)
    corrections = defined_in("test_corrections.py")
    assert {name.split("_")[1] for name in corrections if name.startswith("test_")} == set(sections)
    notes = re.findall(r"^\* \(([a-z])\)", PAGE, flags=re.M)
    assert set(notes) == {note for row in ROWS for note in re.findall(r"note \((\w)\)", row[4])}
    # a counterexample that runs under each heading
    assert all(">>> " in text for text in re.split(r"^### ", PAGE, flags=re.M)[1:])
