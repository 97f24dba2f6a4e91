"""What the live comparisons share: the binary, the scenes, and one line a comparison at the end of the run."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from tests import live, parity
from tests.agreement import Agreement

ROOT = Path(__file__).resolve().parents[2]
#: The name of a test's property that has its comparison's line; properties come back from workers too.
AGREEMENT = "agreement"


@pytest.fixture(scope="session")
def command() -> list[str]:
    """The program: the one that ``NSQ_GPU_BINARY`` names, or the one that ``cargo build`` makes."""
    binary = Path(os.environ.get("NSQ_GPU_BINARY", ROOT / "target" / "debug" / "nsq-gpu"))
    if not binary.exists():
        pytest.fail(f"{binary} does not exist; run `cargo build`, or name it in NSQ_GPU_BINARY")
    return [str(binary)]


@pytest.fixture
def report(request: pytest.FixtureRequest) -> Callable[[str, Path, Agreement], None]:
    """Keeps a comparison's line for the end of the run, and fails the test where a limit was broken."""

    def judge(title: str, scene: Path, agreement: Agreement) -> None:
        request.node.user_properties.append((AGREEMENT, f"{title:6} {parity.line(scene, agreement)}"))
        assert not agreement.violations, "\n".join(agreement.violations)

    return judge


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leaves this run a third of the tests that are marked so."""
    marked = [item for item in items if item.get_closest_marker("in_turn")]
    kept = set(live.in_turn(marked))
    left_out = [item for item in marked if item not in kept]
    config.hook.pytest_deselected(items=left_out)
    items[:] = [item for item in items if item not in set(left_out)]


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    calls = (test for tests in terminalreporter.stats.values() for test in tests if getattr(test, "when", "") == "call")
    lines = sorted(line for call in calls for name, line in call.user_properties if name == AGREEMENT)
    if lines:
        terminalreporter.section("worst deviations from Optiland")
        terminalreporter.write_line("\n".join(lines))
