"""How a scenario names a user class: ``package.module:Name``."""

import re
import sys
from typing import NamedTuple

from dynpf_protocol.errors import ScenarioError

__all__ = ["CLASS_NAME", "MODULE_NAME", "UserClass", "is_standard"]

MODULE_NAME = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*")
CLASS_NAME = re.compile(rf"{MODULE_NAME.pattern}:[^\W\d]\w*")


class UserClass(NamedTuple):
    """A class that a scenario names, and the key that names it."""

    key: str
    module: str
    name: str

    @property
    def text(self) -> str:
        """The class as a scenario names it."""
        return f"{self.module}:{self.name}"

    def wrong(self, what: str) -> ScenarioError:
        """Return the error that says what is wrong with the class."""
        return ScenarioError(f"{self.key}: {self.text!r}: {what}")


def is_standard(module: str) -> bool:
    """Return whether a module belongs to Python itself or is the running program; neither holds components."""
    return module.partition(".")[0] in {*sys.stdlib_module_names, "__main__"}
