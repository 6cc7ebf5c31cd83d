"""Includes the packages of the neighbouring folders in the distributions of dynpf-lab."""

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class Packages(BuildHookInterface[Any]):
    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if version == "editable":
            return  # finds them where they lie
        for folder in self.build_config.dev_mode_dirs:
            if folder != ".":
                packages = Path(self.root, folder).glob("dynpf_*")
                build_data["force_include"] |= {str(package): package.name for package in sorted(packages)}
