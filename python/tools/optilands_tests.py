"""A plugin of pytest for Optiland's own tests of scenes: every trace by its TorchBackend is done by ``nsq-gpu``.

``make test-torch`` runs it, in the folder of Optiland's source package, which holds the tests.
"""

from __future__ import annotations

from typing import Any

import optiland.nonsequential.backends.torch_backend as torch_backend
import pytest

import nsq_gpu

#: Tests of what TorchBackend alone has.
_OF_TORCH_ALONE = {
    "test_visibility_grad_zero_is_documented_limitation": "it traces nothing, but asks TorchBackend for its random numbers",
    "test_nonzero_split_depth_warns": "TorchBackend warns that it does not split rays, and nsq-gpu splits them",
}

_num_traces = 0


class _Counted(nsq_gpu.NsqGpuBackend):
    def trace(self, *args: Any, **kwargs: Any) -> Any:
        global _num_traces
        _num_traces += 1
        return super().trace(*args, **kwargs)


def pytest_configure() -> None:
    torch_backend.TorchBackend = _Counted
    nsq_gpu.use(_Counted())


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.name in _OF_TORCH_ALONE:
            item.add_marker(pytest.mark.skip(reason=_OF_TORCH_ALONE[item.name]))


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    if exitstatus == 0 and _num_traces == 0:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: Any) -> None:
    terminalreporter.write_line(f"traces by nsq-gpu: {_num_traces}")
