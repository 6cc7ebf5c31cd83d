"""Sets a live page up: its HTML, its audience, and who watches the run for it."""

from dynpf_experiments.pictures.live import LiveRun
from dynpf_runtime.bus.edge import new_boot
from dynpf_runtime.plan import Plan
from dynpf_services.scenario.schema import Scenario

from dynpf_lab.live.audience import Audience
from dynpf_lab.live.document import live_document
from dynpf_lab.live.server import Page
from dynpf_lab.live.watching import Watching, acts_of_run

__all__ = ["live_page"]


def live_page(scenario: Scenario, plan: Plan, *, acts: bool) -> tuple[Page, Watching]:
    """Return the page of a run of ``plan``, on which a person may act if ``acts``, and who watches the run for it."""
    begin = {
        "title": scenario.title,
        "acts": sorted(acts_of_run(plan)) if acts else [],
        "mayAct": acts,
        "clock": plan.clock,
        "seed": plan.seed,
    }
    audience = Audience(begin)
    watching = Watching(plan, LiveRun(scenario, plan), audience, boot=new_boot() if acts else "")
    html, policy = live_document(scenario.title, [f"seed {plan.seed}", plan.clock], may_act=acts)
    return Page(html, policy, audience, watching.act if acts else None), watching
