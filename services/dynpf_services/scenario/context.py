"""The context in which a node is built: its name, the run's seed and tick, and the tables that nodes share."""

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

    ``once`` makes objects that several nodes of a process share, such as a map, only once.
    """

    def __init__(self, scenario: "Scenario", name: str, shared: dict[str, Any] | None = None) -> None:
        self.scenario = scenario
        self.name = name
        self._shared: dict[str, Any] = {} if shared is None else shared

    @property
    def seed(self) -> int:
        """The run's seed."""
        return self.scenario.seed

    @property
    def tick_s(self) -> float:
        """The source's period, s."""
        return self.scenario.tick_s

    def fact(self, key: str) -> Any:
        """Return the shared table ``key``, None if the scenario has none."""
        return self.scenario.facts.get(key)

    def opened(self, key: str) -> Any:
        """Return what the shared table ``key`` describes, such as the maps of [map]; None if the scenario has none."""
        if key not in fact_names():
            raise ScenarioError(f"{self.name}: there is no table {key!r}; there are {', '.join(fact_names())}")
        if key not in self.scenario.facts:
            return None
        opened = fact_kind(key).opened
        return self.fact(key) if opened is None else opened(self)

    def surroundings(self) -> "list[tuple[Surroundings, Any]]":
        """Return the surroundings that shared tables describe, each with its table."""
        tables = ((fact_kind(key).surroundings, value) for key, value in self.scenario.facts.items())
        return [(world, value) for world, value in tables if world is not None and value is not None]

    def beside(self, node: str) -> Any:
        """Return the configuration of another node of the same robot by its name, or None."""
        namespace, slash, _ = self.name.rpartition("/")
        return self.scenario.nodes.get(namespace + slash + node)

    def user_class(self, name: str) -> type | None:
        """Import a user class and return it; None if it must not be imported.

        Raises ScenarioError if it does not exist.
        """
        user = next(user for user in self.scenario.user_classes if user.text == name)
        return find_class(user) if user.module in self.scenario.user_code else None

    def user_classes(self) -> dict[str, type]:
        """Import the user classes that the scenario names, and return them by name.

        Raises ScenarioError for a class that does not exist, and for one whose module is not in ``user_code``: it is
        from the scenario of a recording, and its reader has not allowed it.
        """
        return self.once("classes", self._imported)

    def _imported(self) -> dict[str, type]:
        named = self.scenario.user_classes
        check_allowed(named, self.scenario.user_code, "scenario")
        return {user.text: find_class(user) for user in named}

    def file(self, path: str, key: str) -> bytes:
        """Return the content of a file that the scenario names; raises ScenarioError naming ``key`` if it is absent."""
        return self.scenario.file(path, key)

    def once(self, what: str, make: "Callable[[], T]") -> T:
        """Return the result of ``make``, which is called once for all nodes that are built together."""
        if what not in self._shared:
            self._shared[what] = make()
        found: T = self._shared[what]
        return found
