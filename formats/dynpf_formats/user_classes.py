"""How a scenario names a class of the user's own: ``package.module:Name``."""

import re
import sys
from typing import NamedTuple

from dynpf_protocol.errors import ScenarioError

__all__ = ["CLASS_NAME", "MODULE_NAME", "UserClass", "is_standard"]

MODULE_NAME = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*")
CLASS_NAME = re.compile(rf"{MODULE_NAME.pattern}:[^\W\d]\w*")


class UserClass(NamedTuple):
    """A class that a scenario names, and the key at which it does."""

    key: str
    module: str
    name: str

    @property
    def text(self) -> str:
        """The class as a scenario names it."""
        return f"{self.module}:{self.name}"

    def wrong(self, what: str) -> ScenarioError:
        return ScenarioError(f"{self.key}: {self.text!r}: {what}")


def is_standard(module: str) -> bool:
    """Return whether a module is Python's own, or the running program: none of these holds a component."""
    return module.partition(".")[0] in {*sys.stdlib_module_names, "__main__"}
