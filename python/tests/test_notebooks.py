"""Notebooks: what each must hold, and that its cells run.

``make notebooks`` runs the cells, and keeps what they show in the folder that ``NSQ_GPU_NOTEBOOKS`` names. Other runs of these
tests read the pages alone, because ``make docs`` runs the cells as well.
"""

from __future__ import annotations

import ast
import os
import re
from pathlib import Path

import pytest

from tests import live

PACKAGE = Path(__file__).resolve().parents[1]
FOLDER = PACKAGE.parent / "docs" / "notebooks"
PAGES = sorted(FOLDER.glob("*.md"))
CELL = re.compile(r"^```\{code-cell\} ipython3\n(.*?)^```$", re.MULTILINE | re.DOTALL)
#: Of a paper, a book or a guide that a number is held against: the year, the edition, or the chapter.
SOURCE = re.compile(r"\b(1[89]|20)\d\d\b|\bedition\b|\bchapter\b")
#: A call that draws.
PICTURE = re.compile(r"\.(plot|imshow|contourf)\b")
#: Longest time of a cell [s].
LONGEST = 120


def shortcomings(text: str) -> list[str]:
    """Return what a notebook lacks."""
    cells = CELL.findall(text)
    prose = CELL.sub("", text)
    trees = [ast.parse(cell) for cell in cells]
    before, _, rest = text.partition("```{code-cell}")
    wanted = {
        "the question, before the first cell": "**Question.**" in before and "?" in before,
        "a picture by the first cell": bool(cells) and bool(PICTURE.search(cells[0])),
        "a source of the number that it is held against": bool(SOURCE.search(prose)),
        "an assertion": any(isinstance(node, ast.Assert) for tree in trees for node in ast.walk(tree)),
        "its rays, printed": bool(cells) and "rays" in cells[-1] and "print" in cells[-1],
        "its seconds, printed": bool(cells) and "perf_counter() - started" in cells[-1],
        "no output that was saved": "```{code-cell-output}" not in rest and "image/png" not in rest,
    }
    return [name for name, holds in wanted.items() if not holds]


def run(page: Path, output: Path) -> None:
    """Run the cells of a page, and write them with what they show."""
    import jupytext
    import nbclient

    notebook = jupytext.read(page)
    # A bar would stay in what a cell shows.
    environment = {**os.environ, "PYTHONPATH": str(PACKAGE), "NSQ_GPU_BINARY": live.binary(), "TQDM_DISABLE": "1"}
    client = nbclient.NotebookClient(notebook, timeout=LONGEST, kernel_name="python3", resources={"metadata": {"path": str(page.parent)}})
    client.execute(env=environment)
    jupytext.write(notebook, output)


def test_all_are_here() -> None:
    assert {page.stem for page in PAGES} >= {"first-lens", "ghosts", "changes", "sweep", "search"}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_asks_shows_and_checks(page: Path) -> None:
    assert shortcomings(page.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(("cut", "instead"), [
    ("**Question.**", ""), ("assert ", "not "), ("time.perf_counter() - started", "0"), ("rays", "light"), ("plot", "show"), ("edition", "")])
def test_what_is_missing_is_noticed(cut: str, instead: str) -> None:
    text = (FOLDER / "first-lens.md").read_text(encoding="utf-8").replace("chapter", "")
    assert shortcomings(text) == []
    assert shortcomings(text.replace(cut, instead)) != []


@pytest.mark.skipif("NSQ_GPU_NOTEBOOKS" not in os.environ, reason="`make notebooks` and `make docs` run the cells")
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_runs(page: Path) -> None:
    folder = Path(os.environ["NSQ_GPU_NOTEBOOKS"])
    folder.mkdir(exist_ok=True)
    run(page, folder / f"{page.stem}.ipynb")


@pytest.mark.skipif("NSQ_GPU_NOTEBOOKS" not in os.environ, reason="`make notebooks` and `make docs` run the cells")
def test_an_error_in_a_cell_fails(tmp_path: Path) -> None:
    nbclient = pytest.importorskip("nbclient")
    page = tmp_path / "wrong.md"
    head = (FOLDER / "first-lens.md").read_text(encoding="utf-8").partition("# First lens")[0]
    page.write_text(f"{head}```{{code-cell}} ipython3\nassert 1 == 2, 'the sum is wrong'\n```\n", encoding="utf-8")
    with pytest.raises(nbclient.exceptions.CellExecutionError, match="the sum is wrong"):
        run(page, tmp_path / "wrong.ipynb")
