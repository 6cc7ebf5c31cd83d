"""What a node is built of: its name, the run's seed and tick, and what nodes share."""

from typing import TYPE_CHECKING, Any, TypeVar

from dynpf_protocol.errors import ScenarioError

from dynpf_services.scenario.kinds import fact_kind, fact_names
from dynpf_services.scenario.user_code import check_allowed, find_class

if TYPE_CHECKING:
    from collections.abc import Callable

    from dynpf_services.scenario.kinds import Surroundings
    from dynpf_services.scenario.schema import Scenario

__all__ = ["Context"]

T = TypeVar("T")


class Context:
    """One node's view of its scenario.

    ``once`` keeps what several nodes of a process share, such as a map, from being made more than once.
    """

    def __init__(self, scenario: "Scenario", name: str, shared: dict[str, Any] | None = None) -> None:
        self.scenario = scenario
        self.name = name
        self._shared: dict[str, Any] = {} if shared is None else shared

    @property
    def seed(self) -> int:
        return self.scenario.seed

    @property
    def tick_s(self) -> float:
        return self.scenario.tick_s

    def fact(self, key: str) -> Any:
        """Return the table ``key`` that nodes share, None where the scenario has none."""
        return self.scenario.facts.get(key)

    def opened(self, key: str) -> Any:
        """Return what the table ``key`` stands for, such as the maps of [map]; None where the scenario has none."""
        if key not in fact_names():
            raise ScenarioError(f"{self.name}: there is no table {key!r}; there are {', '.join(fact_names())}")
        if key not in self.scenario.facts:
            return None
        opened = fact_kind(key).opened
        return self.fact(key) if opened is None else opened(self)

    def surroundings(self) -> "list[tuple[Surroundings, Any]]":
        """Return what tables of the run say of the world about a robot, each with its table."""
        tables = ((fact_kind(key).surroundings, value) for key, value in self.scenario.facts.items())
        return [(world, value) for world, value in tables if world is not None and value is not None]

    def beside(self, node: str) -> Any:
        """Return the configuration of another node of the same robot, None where there is none of that name."""
        namespace, slash, _ = self.name.rpartition("/")
        return self.scenario.nodes.get(namespace + slash + node)

    def user_class(self, name: str) -> type | None:
        """Import a class of the user's; None for one that must not be imported.

        Raises ScenarioError for one that is not there.
        """
        user = next(user for user in self.scenario.user_classes if user.text == name)
        return find_class(user) if user.module in self.scenario.user_code else None

    def user_classes(self) -> dict[str, type]:
        """Import the user's classes that the scenario names.

        Raises ScenarioError for one that is not there, and imports none whose module ``user_code`` lacks: those are of
        a scenario out of a recording, and its reader has not allowed them.
        """
        return self.once("classes", self._imported)

    def _imported(self) -> dict[str, type]:
        named = self.scenario.user_classes
        check_allowed(named, self.scenario.user_code, "scenario")
        return {user.text: find_class(user) for user in named}

    def file(self, path: str, key: str) -> bytes:
        """Return what is in a file that the scenario names; raises ScenarioError naming ``key`` if it is not there."""
        return self.scenario.file(path, key)

    def once(self, what: str, make: "Callable[[], T]") -> T:
        """Return what ``make`` returns, made once for all nodes that are built together."""
        if what not in self._shared:
            self._shared[what] = make()
        found: T = self._shared[what]
        return found
