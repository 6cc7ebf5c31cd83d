"""The page docs/amcl.md: what becomes of each parameter of AMCL; written by `python -m docs.reference`."""

from dynpf_systems.rooms.amcl.parameters import PARAMETERS, ROS1_NAMES

from docs.fields import table

__all__ = ["amcl"]

HEAD = """\
<!-- Made by `make docs` from the code; do not edit. -->
# AMCL's parameters

`dynpf import amcl PARAMS.yaml -o mine.toml` makes a scenario of the parameters of AMCL, and prints what becomes of
each; `dynpf run mine.toml --log IN.mcap` runs it on an imported log with laser scans, and `dynpf localize BAG --amcl
PARAMS.yaml` does both. The file is `nav2_params.yaml` (the section `amcl: ros__parameters:`, in any namespace), or
what `rosparam dump` writes in ROS 1. It is read as data, of at most 262144 characters. What it does not give has
AMCL's default. Unknown keys are told; a wrong value is refused with the key, the value and what was expected.

The filter then does as AMCL does, as far as the table says. What AMCL lacks, the search of a whole map and the test
for a jump, has the scenario `laser-log` ([logs](logs.md#a-robot-that-is-lost)). The names are Nav2's; ROS 1's are in
brackets where they differ. Of two defaults the second is ROS 1's.

"""


def amcl() -> str:
    """Return the page of AMCL's parameters."""
    ros1 = {ours: name for name, ours in ROS1_NAMES.items()}
    rows = (
        (
            f"`{row.name}`" + (f" (`{ros1[row.name]}`)" if row.name in ros1 else ""),
            row.expected,
            ", ".join(dict.fromkeys(_default(value) for value in (row.default, row.ros1) if value is not None)),
            row.fate,
        )
        for row in PARAMETERS
    )
    return HEAD + "\n".join([*table(("Parameter", "Expected", "Default", "What becomes of it"), rows), ""])


def _default(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value).lower() if isinstance(value, bool) else str(value)
