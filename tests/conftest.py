"""In CI everything is there that tests need: what they skip for the want of it is a failure."""

import os
from collections.abc import Generator
from typing import Any

import pytest

PROCESSORS = ("this processor", "no effect here", "OpenCV has no choice")
"""How reasons begin that are the processor's and no fault of the machine's set-up."""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    if os.environ.get("CI") == "true" and report.skipped and not hasattr(report, "wasxfail"):
        reason = _reason(report.longrepr)
        if not reason.startswith(PROCESSORS):
            report.outcome = "failed"
            report.longrepr = f"skipped in CI, where nothing may be missing: {reason}"
    return report


def _reason(longrepr: Any) -> str:
    text = longrepr[2] if isinstance(longrepr, tuple) else str(longrepr)
    return str(text).removeprefix("Skipped: ")
