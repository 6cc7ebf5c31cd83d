"""User nodes as nodes of the runtime."""

from collections.abc import Mapping, Sequence
from typing import Any, get_type_hints

import msgspec
import numpy as np
from dynpf_protocol.errors import ScenarioError
from dynpf_protocol.messages import Message
from dynpf_protocol.topics import Topic
from dynpf_runtime.node import Output, Result, State, Step

from dynpf_services.nodes import Moment, Node
from dynpf_services.scenario.context import Context
from dynpf_services.scenario.kinds import NodeKind
from dynpf_services.scenario.schema import key_of
from dynpf_services.scenario.user_component import UserComponent

__all__ = ["KIND", "UserNode", "build"]


class UserNode:
    """Adapts a user node to the runtime: holds its parameters, and its state from step to step."""

    def __init__(self, node: Node, context: Context) -> None:
        self.name = context.name
        self._node = node
        self._context = context
        self._state: Any = _first_state(node)
        self._topics = _rows(type(node), context.name)

    def step(self, step: Step) -> Result:
        """Run the user's step; raises TypeError if it returns something else than a step should."""
        context = self._context
        moment = Moment(*step, node=self.name, seed=context.seed, fact=context.opened)
        found = self._node.step(self._state, moment)
        if not isinstance(found, tuple) or len(found) not in (2, 3):
            raise TypeError(f"step returned {found!r}; expected (state, messages), or (state, messages, finished)")
        state, messages, finished = (*found, False)[:3]
        if type(state) is not type(self._state):
            raise TypeError(
                f"step returned a state of type {type(state).__name__}; expected {type(self._state).__name__}"
            )
        self._state = state
        return Result(tuple(self._checked(self._output(message)) for message in messages), finished=bool(finished))

    @staticmethod
    def _checked(output: Output) -> Output:
        """Return an output whose fields have their types; those of a struct are not checked when it is made."""
        try:
            msgspec.convert(msgspec.to_builtins(output.message), type(output.message))
        except msgspec.ValidationError as error:
            raise TypeError(f"{output.topic}: {type(output.message).__name__}: {error}") from error
        return output

    def _output(self, message: Any) -> Output:
        if isinstance(message, tuple):
            return Output(*message)
        fitting = [own for own, row in self._topics.items() if row.type is type(message)]
        if len(fitting) != 1:
            topics = ", ".join(self._topics) or "nothing"
            raise TypeError(
                f"returned a {type(message).__name__}, which {len(fitting)} of its topics carry; it writes {topics};"
                " return (topic, message)"
            )
        return Output(fitting[0], message)

    def freeze(self) -> State:
        """Return the state's fields by name."""
        return {name: _plain(value) for name, value in self._state._asdict().items()}

    def thaw(self, state: State) -> None:
        """Restore a state that ``freeze`` returned."""
        kind = type(self._state)
        hints = get_type_hints(kind)
        self._state = kind(**{name: _typed(value, hints.get(name, Any)) for name, value in state.items()})


def build(config: UserComponent, context: Context) -> UserNode:
    """Return a user node; raises ScenarioError if the class is no node, or for parameters that do not fit."""
    kind = _node_class(config, context, context.user_classes()[config.name])
    key = key_of(context.name)
    known = kind.__struct_fields__
    for name in config.parameters:
        if name not in known:
            raise ScenarioError(f"{key}.{name}: unknown key; {config.name} knows {', '.join(known) or 'none'}")
    try:
        node = msgspec.convert(config.parameters, kind)
    except msgspec.ValidationError as error:
        text, _, path = str(error).partition(" - at `$")
        raise ScenarioError(f"{key}{path.rstrip('`')}: {text[:1].lower()}{text[1:]}") from error
    return UserNode(node, context)


def _node_class(config: UserComponent, context: Context, found: type) -> type[Node]:
    if not issubclass(found, Node):
        raise ScenarioError(
            f"{key_of(context.name)}.kind: {config.name!r} is no node; expected a subclass of dynpf_lab.Node"
        )
    if lacking := [name for name in ("step", "sense") if _is_abstract(found, name)]:
        raise ScenarioError(f"{key_of(context.name)}.kind: {config.name!r} has no method {' and no '.join(lacking)}")
    return found


def _is_abstract(kind: type, name: str) -> bool:
    return getattr(getattr(kind, name, None), "__isabstractmethod__", False)


def _first_state(node: Node) -> Any:
    kind = type(node).State
    if not (isinstance(kind, type) and issubclass(kind, tuple) and hasattr(kind, "_fields")):
        raise ValueError(f"{type(node).__name__}.State is {kind!r}; expected a NamedTuple")
    try:
        return kind()
    except TypeError as error:
        raise ValueError(f"{type(node).__name__}.State needs a default for each of its fields: {error}") from error


def _reads(config: UserComponent, context: Context) -> Sequence[str | type[Message]]:
    found = context.user_class(config.name)
    return () if found is None else _node_class(config, context, found).reads


def _writes(config: UserComponent, context: Context) -> Mapping[str, Topic]:
    found = context.user_class(config.name)
    return {} if found is None else _rows(_node_class(config, context, found), context.name)


def _rows(kind: type[Node], node: str) -> dict[str, Topic]:
    rows = {}
    for own, what in kind.writes.items():
        if not isinstance(what, Topic) and not (isinstance(what, type) and issubclass(what, Message)):
            raise ValueError(f"{kind.__name__}.writes: {own!r} is {what!r}; expected a type of messages")
        carried = what.type if isinstance(what, Topic) else what
        if not hasattr(carried, "schema_name"):
            raise ValueError(
                f"{carried.__name__} lacks its schema_name, such as schema_name = 'mylab.{carried.__name__}'"
            )
        if isinstance(what, Topic) and not what.compared:
            raise ValueError(
                f"{kind.__name__}.writes: {own!r} has compared=False; the outputs of a node are always compared"
            )
        described = (kind.__doc__ or kind.__name__).strip().partition("\n")[0].rstrip(".")
        rows[own] = (
            what if isinstance(what, Topic) else Topic(name=own, type=what, publishers=(node,), description=described)
        )
    return rows


def _plain(value: Any) -> Any:
    """Return a value of a state as plain values and arrays."""
    if isinstance(value, np.ndarray | np.generic):
        return value
    if isinstance(value, msgspec.Struct):
        return msgspec.to_builtins(value)
    if isinstance(value, Mapping):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    return value


def _typed(value: Any, hint: Any) -> Any:
    """Return a plain value converted to the type of a state's field; arrays are unchanged."""
    if isinstance(value, np.ndarray):
        return value
    return msgspec.convert(value, hint, dec_hook=lambda _, inner: inner)


KIND = NodeKind(config=UserComponent, build="dynpf_services.scenario.user_nodes:build", reads=_reads, writes=_writes)
