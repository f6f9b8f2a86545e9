"""The version stands in pyproject.toml, and everybody else has it from there."""

from __future__ import annotations

import re

import pytest
from scripts import ROOT, run


def stated(file: str, pattern: str) -> list[str]:
    """What a file says the version is."""
    return re.findall(pattern, (ROOT / file).read_text(encoding="utf-8"), flags=re.M)


VERSION = stated("pyproject.toml", r'^version = "(.+)"$')


def test_the_citation_is_of_the_newest_release_in_the_changelog():
    released = stated("CHANGELOG.md", r"^## \[(\d.*?)\] - \d{4}-\d\d-\d\d$")
    assert stated("CITATION.cff", r"^version: (.+)$") == released[:1]
    dates = stated("CHANGELOG.md", r"^## \[\d.*?\] - (.*)$")
    assert stated("CITATION.cff", r"^date-released: (.+)$") == dates[:1]
    assert dates == sorted(dates, reverse=True)


def test_this_is_the_newest_release_or_a_development_version_after_it():
    (version,) = VERSION
    (newest, *_) = stated("CHANGELOG.md", r"^## \[(\d.*?)\]")
    if version != newest:
        number, _, development = version.partition(".dev")
        assert development.isdecimal()
        assert [int(part) for part in number.split(".")] > [int(part) for part in newest.split(".")]
        assert stated("CHANGELOG.md", r"^## \[(.*?)\]")[:1] == ["Unreleased"]


def test_the_recipe_is_of_this_version_and_needs_what_the_package_does():
    assert stated("conda/meta.yaml", r'^\{% set version = "(.+)" %\}$') == VERSION
    (needed,) = stated("pyproject.toml", r"^dependencies = \[(.+)\]$")
    ours = {name.replace(">=", " >=") for name in re.findall(r'"([^"]+)"', needed)}
    recipe = (ROOT / "conda/meta.yaml").read_text(encoding="utf-8").partition("  run:\n")[2].partition("\n\n")[0]
    theirs = {line.strip(" -").replace("-base", "") for line in recipe.splitlines()}
    assert theirs - {"python >=3.10"} == ours


@pytest.mark.parametrize(
    "code",
    ["import ph_control; print(ph_control.__version__)", "from ph_control.cli import main; main(['--version'])"],
)
def test_the_installed_distribution_tells_its_version(tmp_path, code):
    installed = tmp_path / "ph_control-7.8.9.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: ph_control\nVersion: 7.8.9\n", encoding="utf-8")
    done = run(tmp_path, "-c", code)
    assert done.stdout.split()[-1] == "7.8.9", done.stderr


def test_without_an_installation_there_is_no_version(tmp_path):
    code = """if True:
        import importlib.metadata
        def version(name):
            raise importlib.metadata.PackageNotFoundError(name)
        importlib.metadata.version = version
        import ph_control
        print(getattr(ph_control, "__version__", "none"))
    """
    assert run(tmp_path, "-c", code).stdout == "none\n"


def test_the_version_is_not_looked_up_before_it_is_asked_for(tmp_path):
    code = "import ph_control, sys; print('__version__' in vars(ph_control), 'ph_control.systems' in sys.modules)"
    assert run(tmp_path, "-c", code).stdout == "False False\n"
