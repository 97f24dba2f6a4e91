"""A kernel of Jupyter's: bars, tables, pictures, and what the button that stops a cell leaves."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests import live

jupyter_client = pytest.importorskip("jupyter_client")
pytest.importorskip("ipykernel")

FOLDER = Path(__file__).resolve().parents[1]
#: Longest time that a cell may take [s].
PATIENCE = 120.0
#: A message of the kernel: its kind, and what it holds.
Messages = list[tuple[str, dict[str, Any]]]


class Kernel:
    """A notebook's kernel, whose cells are run one by one."""

    def __init__(self) -> None:
        environment = {**os.environ, "PYTHONPATH": str(FOLDER), "NSQ_GPU_BINARY": live.binary(), "TQDM_DISABLE": ""}
        del environment["TQDM_DISABLE"]
        self._manager = jupyter_client.KernelManager(kernel_name="python3")
        self._manager.start_kernel(env=environment, cwd=str(FOLDER))
        self._client = self._manager.client()
        self._client.start_channels()
        self._client.wait_for_ready(timeout=PATIENCE)

    def run(self, cell: str, on_message: Callable[[str, dict[str, Any]], None] = lambda kind, content: None) -> Messages:
        """Run a cell; return its messages."""
        of_cell, messages = self._client.execute(cell), []
        while True:
            message = self._client.get_iopub_msg(timeout=PATIENCE)
            if message["parent_header"].get("msg_id") != of_cell:
                continue
            kind, content = message["msg_type"], message["content"]
            if kind == "status" and content["execution_state"] == "idle":
                return messages
            messages.append((kind, content))
            on_message(kind, content)

    def printed(self, cell: str) -> str:
        """Return what a cell prints."""
        messages = self.run(cell)
        assert not [content for kind, content in messages if kind == "error"], messages
        return "".join(content["text"] for kind, content in messages if kind == "stream" and content["name"] == "stdout")

    def data(self, cell: str) -> dict[str, str]:
        """Return a cell's last value, or its picture, by the kinds that the notebook may choose from."""
        return next(content["data"] for kind, content in reversed(self.run(cell)) if kind in ("execute_result", "display_data"))

    def stop(self) -> None:
        """Stop the cell that runs, as the notebook's button does: by SIGINT to the kernel's process group."""
        self._manager.interrupt_kernel()

    def end(self) -> None:
        self._client.stop_channels()
        self._manager.shutdown_kernel(now=True)


@pytest.fixture(scope="module")
def kernel() -> Iterator[Kernel]:
    found = Kernel()
    try:
        found.run("import sys, warnings; warnings.simplefilter('ignore')\n"
                  "import nsq_gpu, nsq_gpu.cluster\nfrom nsq_gpu import NsqGpuBackend, Session\nfrom tests.live import bench\n"
                  "scene = bench(); session = Session()")
        yield found
    finally:
        found.end()


#: Calls that would last for ever, and what their partial result has traced.
ENDLESS = {
    "sweep": ("session.sweep(scene, {'screen.z': [30.0 + i / 1e6 for i in range(100_000)]}, 100_000, progress=told)",
              "int((partial.num_rays > 0).sum()), partial.partial"),
    "session": ("session.trace(scene, 10**11, progress=told)", "partial.num_rays_total, partial.partial"),
    "backend": ("scene.trace(10**11, backend=NsqGpuBackend(progress=told))", "partial.num_rays_total, partial.partial"),
    "diff": ("nsq_gpu.diff(scene, scene, 10**11, progress=told)", "partial.num_rays, partial.partial"),
    "jacobian": ("nsq_gpu.jacobian(scene, 'lamp.total_flux', 10**11, progress=told)",
                 "partial.report['num_rays_total'], partial.partial"),
}


@pytest.mark.skipif(os.name == "nt", reason="signals are POSIX's")
@pytest.mark.parametrize("name", ENDLESS)
def test_a_cell_that_is_stopped_leaves_what_it_had_computed(kernel: Kernel, name: str) -> None:
    call, counted = ENDLESS[name]
    stopped: list[float] = []

    def stop(kind: str, content: dict[str, Any]) -> None:
        # The cell says that it has traced rays.
        if kind == "stream" and "rays done" in content["text"] and not stopped:
            stopped.append(time.monotonic())
            kernel.stop()

    cell = (f"said = []\ndef told(rays, num_rays, rate):\n    if rays > 200_000 and not said:\n        said.append(rays)\n"
            f"        print('rays done', flush=True)\n{call}")
    messages = kernel.run(cell, stop)
    assert stopped and time.monotonic() - stopped[0] < 30.0
    assert [content["ename"] for kind, content in messages if kind == "error"] == ["Interrupted"]
    rays, is_partial = eval(kernel.printed(f"partial = sys.last_value.partial; print(({counted}))"))
    assert rays > 0 and is_partial is True
    # The kernel and the session go on.
    assert kernel.printed("print(session.trace(scene, 1000).num_rays_total)") == "1000\n"


@pytest.mark.skipif(os.name == "nt", reason="signals are POSIX's")
def test_a_cell_that_is_stopped_at_its_bar_keeps_its_bar_in_red(kernel: Kernel) -> None:
    def stop(kind: str, content: dict[str, Any]) -> None:
        if kind == "display_data":
            time.sleep(1.0)
            kernel.stop()

    messages = kernel.run("session.trace(scene, 10**11, progress=True)", stop)
    assert [content["ename"] for kind, content in messages if kind == "error"] == ["Interrupted"]
    styles = [content["data"]["state"]["bar_style"] for kind, content in messages
              if kind == "comm_msg" and "bar_style" in content["data"].get("state", {})]
    assert styles[-1] == "danger"


@pytest.mark.parametrize("call", ["session.sweep(scene, {'screen.z': [30, 31]}, 100_000, progress=True)",
                                  "scene.trace(100_000, backend=NsqGpuBackend(progress=True))",
                                  "nsq_gpu.progress.UNASKED_AFTER = 0.0; session.trace(scene, 100_000)"])
def test_a_notebook_has_the_bar_of_a_notebook(kernel: Kernel, call: str) -> None:
    messages = kernel.run(f"found = {call}" if ";" not in call else call)
    assert any("application/vnd.jupyter.widget-view+json" in content.get("data", {}) for kind, content in messages
               if kind == "display_data")
    values = [content["data"]["state"]["value"] for kind, content in messages
              if kind in ("comm_msg", "comm_open") and "value" in content["data"].get("state", {})]
    assert any(re.search(r"(100|200)k\sof\s(100|200)k\srays", str(value)) for value in values)
    assert not [content for kind, content in messages if kind == "stream"]


@pytest.mark.parametrize(("value", "expected"), [
    ("session.trace(scene, 1000)", "Result: 1,000 rays"),
    ("session.trace(scene, 1000, paths=True).paths", "PathTable: "),
    ("session.sweep(scene, {'screen.z': [30, 31]}, 1000)", "Sweep: 2 points of screen.z"),
    ("nsq_gpu.jacobian(scene, 'lamp.total_flux', 1000)", "Jacobian: 1,000 rays"),
    ("nsq_gpu.jacobian(scene, 'lamp.total_flux', 1000)['lamp.total_flux', 'screen']", "Derivative: "),
    ("nsq_gpu.loss_gradient(scene, 'lamp.total_flux', {'screen': __import__('numpy').ones((12, 12))}, 1000)", "LossGradient"),
    ("nsq_gpu.diff(scene, scene, 1000)", "Difference: 1,000 rays"),
    ("scene", "NSQScene: 0 components"),
])
def test_a_notebook_shows_a_table(kernel: Kernel, value: str, expected: str) -> None:
    shown = kernel.data(value)
    assert expected in shown["text/html"]
    assert expected in shown["text/plain"] or "lamp.total_flux" in shown["text/plain"]
    assert ("<table>" in shown["text/html"]) == ("Derivative" not in expected)


def test_a_notebook_shows_a_picture(kernel: Kernel) -> None:
    shown = kernel.data("%matplotlib inline\nsession.trace(scene, 100_000).plot(scale='log');")
    assert len(shown["image/png"]) > 5_000


def test_the_cells_of_the_page_about_notebooks_run(kernel: Kernel, tmp_path: Path) -> None:
    page = (live.ROOT / "docs" / "how-to" / "notebooks.md").read_text(encoding="utf-8")
    cells = [part.split("```")[0] for part in page.split("```python\n")[1:]]
    assert len(cells) >= 8
    (tmp_path / "docs").symlink_to(live.ROOT / "docs")
    assert kernel.printed(f"import os; os.chdir({str(tmp_path)!r})") == ""
    for cell in cells:
        if "last_value" not in cell:
            assert kernel.printed(cell.replace("1_000_000", "20_000").replace("100_000", "2_000")) == ""
    assert kernel.printed("print(nsq_gpu.load('run_1').num_rays_total, found.shape)") == "20000 (11, 2)\n"
    kernel.run(f"nsq_gpu.use(None); os.chdir({str(FOLDER)!r})")
