"""The router waits for the recorder's last word, which may come after its token, and says for whom a run waits."""

from dynpf_protocol.control import Recorded, encode_control
from dynpf_protocol.errors import BrokenOffError
from dynpf_protocol.keys import ALIVE, READY, RECORDED
from dynpf_runtime.machines.effects import Ended, Tell
from dynpf_runtime.machines.events import Arrived, Event, Now, Started, Token, Woke
from dynpf_runtime.machines.absence import LAST_WORD_NS
from dynpf_runtime.machines.router import RouterMachine
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario

PLAN = plan_of(load_scenario("landmark-room"))
LAST_WORD = Arrived(RECORDED, encode_control(Recorded("r1", True, "finished", "run.mcap")), b"")


def left_by_all() -> RouterMachine:
    """Return a router whose run has begun, and whose processes have left at 0 ns."""
    router = RouterMachine(PLAN, "router-1")
    assert ended(router, Started(), 0) is None
    names = (*PLAN.graph.nodes, "recorder")
    for key in (f"{prefix}{name}/{name[0]}1" for prefix in (ALIVE, READY) for name in names):
        assert ended(router, Token(key, True), 0) is None
    for key in (f"{prefix}{name}/{name[0]}1" for name in names for prefix in (READY, ALIVE)):
        assert ended(router, Token(key, False), 0) is None
    return router


def ended(router: RouterMachine, event: Event, now_ns: int) -> Ended | None:
    return next((effect for effect in router.handle(event, Now(now_ns, now_ns)) if isinstance(effect, Ended)), None)


def test_a_last_word_that_comes_after_the_tokens_have_gone_counts() -> None:
    router = left_by_all()
    assert router.wake_ns <= LAST_WORD_NS
    assert ended(router, LAST_WORD, LAST_WORD_NS // 2) == Ended(None)


def test_without_a_last_word_the_run_has_broken_off() -> None:
    router = left_by_all()
    assert ended(router, Woke(), LAST_WORD_NS - 1) is None
    assert router.wake_ns <= LAST_WORD_NS
    end = ended(router, Woke(), LAST_WORD_NS)
    assert end is not None
    assert isinstance(end.error, BrokenOffError)
    assert str(end.error) == "all processes left before the run was recorded"


def test_a_process_that_comes_back_meanwhile_is_waited_for() -> None:
    router = left_by_all()
    assert ended(router, Token(f"{ALIVE}recorder/r1", True), 1) is None
    assert ended(router, Woke(), 2 * LAST_WORD_NS) is None


def test_a_strangers_tokens_neither_begin_nor_end_the_run_nor_keep_it() -> None:
    router = RouterMachine(PLAN, "router-1")
    assert ended(router, Started(), 0) is None
    for prefix in (ALIVE, READY):
        for name in ("nobody", "estimator", "recorder"):  # not all of the run have come yet
            assert ended(router, Token(f"{prefix}{name}/x", True), 0) is None
    for name in ("nobody", "estimator", "recorder"):
        assert ended(router, Token(f"{ALIVE}{name}/x", False), 0) is None
    assert ended(router, Woke(), 10 * LAST_WORD_NS) is None
    router = left_by_all()
    for name in ("nobody", "estimator", "recorder"):
        for number in range(100):
            assert ended(router, Token(f"{ALIVE}{name}/x{number}", True), 1) is None
    assert ended(router, LAST_WORD, 2) == Ended(None)


def test_a_router_whose_run_does_not_begin_says_for_whom_it_waits_and_since_when() -> None:
    router = RouterMachine(PLAN, "router-1")
    told: list[str] = []
    events: list[Event] = [Started(), *(Token(f"{ALIVE}{name}/b", True) for name in ("recorder", "sensors"))]
    for tenths in range(450):
        now_ns = tenths * 10**8
        for event in events or [Woke()]:
            told += [effect.text for effect in router.handle(event, Now(now_ns, now_ns)) if isinstance(effect, Tell)]
        events = []
    waited = "the run has waited for controller, estimator, simulator for {} s; Ctrl-C ends it"
    assert told == [waited.format(seconds) for seconds in (5, 10, 20, 40)]
