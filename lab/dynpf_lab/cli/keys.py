"""``dynpf keys``: a certificate authority of one's own, and a certificate for each process of a run."""

import argparse
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from dynpf_protocol.errors import UsageError
from dynpf_protocol.keys import OBSERVER, OPERATOR, RECORDER, ROUTER

if TYPE_CHECKING:
    from dynpf_runtime.bus.keys import Issued

__all__ = ["add_arguments"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf keys``."""
    actions = parser.add_subparsers(metavar="init|issue|revoke|list", required=True)
    init = actions.add_parser("init", help="make a folder with a certificate authority")
    init.add_argument("folder", type=Path, metavar="FOLDER", help="where to put the authority, its key and all others")
    _add_days(init, "the authority, and no certificate of it longer (default 365)")
    init.set_defaults(run=_init)
    issue = actions.add_parser("issue", help="make a key and a certificate for each of some processes")
    issue.add_argument("names", nargs="*", metavar="NAME", help="node, router, recorder, observer, operator or player")
    issue.add_argument("--scenario", metavar="SCENARIO", help="all processes of this scenario, observer and operator")
    issue.add_argument(
        "--host", action="append", default=[], metavar="HOST", help="name or address of the router's; may be repeated"
    )
    issue.add_argument(
        "--containers",
        action="store_true",
        help="for dynpf compose: the router is the host 'router', and a container's user can read the key it is given",
    )
    _add_days(issue, "the certificates (default 7)")
    issue.set_defaults(run=_issue)
    revoke = actions.add_parser("revoke", help="withdraw the certificate of a process")
    revoke.add_argument("name", metavar="NAME", help="whose certificate is not to be believed any more")
    revoke.set_defaults(run=_revoke)
    listing = actions.add_parser("list", help="the certificates, and when they expire")
    listing.set_defaults(run=_list)
    for action in (issue, revoke, listing):
        action.add_argument("--keys", type=Path, default=Path("keys"), metavar="FOLDER", help="default: keys")


def _add_days(parser: argparse.ArgumentParser, what: str) -> None:
    parser.add_argument("--days", type=_days, metavar="N", help=f"for how long to trust {what}")


def _days(text: str) -> float:
    try:
        days = float(text)
    except ValueError:
        days = 0.0
    if not 0.0 < days <= 36500.0:
        raise argparse.ArgumentTypeError(f"{text}: expected a number of days above 0, at most 36500")
    return days


def _init(options: argparse.Namespace) -> int:
    from dynpf_formats.certificates import AUTHORITY_DAYS
    from dynpf_runtime.bus.keys import init

    until = init(options.folder, datetime.now(UTC), options.days or AUTHORITY_DAYS)
    print(f"{options.folder}/ca.pem: certificate authority until {until:%Y-%m-%d}; keep {options.folder}/ca.key here")
    return 0


def _issue(options: argparse.Namespace) -> int:
    from dynpf_formats.certificates import DAYS
    from dynpf_runtime.bus.keys import LOCAL_HOSTS, issue, issued

    names = [*options.names, *(_processes(options.scenario) if options.scenario else ())]
    if not names:
        raise UsageError("issue: give the NAME of a process, or --scenario SCENARIO for all of it")
    if options.host and ROUTER not in names:
        raise UsageError("issue: --host is for the certificate of the router, which is not among the names")
    hosts = (*LOCAL_HOSTS, *([ROUTER] if options.containers else []), *options.host)
    before = {one.common_name: one.expires for one in issued(options.keys)} if options.keys.is_dir() else {}
    made = issue(
        options.keys,
        names,
        datetime.now(UTC),
        days=options.days or DAYS,
        hosts=hosts,
        for_containers=options.containers,
    )
    for one in made:
        replaced = before.get(one.common_name)
        hint = "" if replaced is None else f"; replaces the one until {replaced:%Y-%m-%d %H:%M} UTC, which stays valid"
        print(f"{one.common_name}: until {one.expires:%Y-%m-%d %H:%M} UTC{hint}")
    return 0


def _processes(scenario: str) -> Sequence[str]:
    from dynpf_services.scenario.build import plan_of
    from dynpf_services.scenario.load import load_scenario

    return ROUTER, RECORDER, *plan_of(load_scenario(scenario)).graph.nodes, OBSERVER, OPERATOR


def _revoke(options: argparse.Namespace) -> int:
    from dynpf_runtime.bus.keys import revoke

    own, removed = revoke(options.keys, options.name)
    if options.name == ROUTER:
        what = "a new router needs a new certificate, and one that runs goes on"
    else:
        what = (
            f"a router that finds {options.keys}/revoked in its folder of keys gives it no access from its next start "
            "on, until then it has access"
        )
    gone = (
        f"removed {', '.join(map(str, removed))}" if removed else f"{options.keys} had no key of it: is the name right?"
    )
    print(f"{own}: revoked; {what}; {gone}. dynpf keys issue {options.name} makes a new certificate")
    return 0


def _list(options: argparse.Namespace) -> int:
    from dynpf_runtime.bus.keys import issued, revoked

    now, withdrawn = datetime.now(UTC), revoked(options.keys)
    for one in issued(options.keys):
        print(f"{one.common_name:<24} {_state(one, now)}")
    for name in withdrawn:
        print(f"{name:<24} revoked")
    return 0


def _state(one: "Issued", now: datetime) -> str:
    left = one.expires - now
    if left.total_seconds() < 0:
        return f"expired on {one.expires:%Y-%m-%d %H:%M} UTC"
    return f"until {one.expires:%Y-%m-%d %H:%M} UTC, {left.total_seconds() / 86400:.1f} days"
