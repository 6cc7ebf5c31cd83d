"""Services that are started one by one, by hand, in an odd order."""

import json

from dynpf_runtime.bus.processes import free_port

SCENARIO = "parts-3-tracked"


def test_services_started_one_by_one_in_an_odd_order_make_a_whole_run(tmp_path, dynpf, here):
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    path, inline = tmp_path / "run.mcap", tmp_path / "inline.mcap"
    shorter = ["--set", "max_ticks=40"]

    def service(name, *words):
        where = "--listen" if name == "router" else "--connect"
        return dynpf("service", name, SCENARIO, *shorter, where, endpoint, *words)

    nodes = {name: service(name) for name in ("simulator", "controller", "estimator", "sensors")}
    for node in nodes.values():
        node.says(f"waiting for the router at {endpoint}")
    router = service("router")
    for name, node in nodes.items():
        node.says(f"dynpf {name}: waiting for recorder\n")

    second = service("estimator")
    other = service("recorder", "-o", tmp_path / "other.mcap", "--set", "estimator.n=7")
    stranger = service("vision")
    assert [second.wait(), other.wait(), stranger.wait()] == [2, 2, 2]
    assert "estimator already runs at" in second.stderr
    assert "this scenario differs from the router's in estimator.n: here 7, there 100" in other.stderr
    assert "vision takes no part in this scenario; its processes are simulator, sensors, estimator" in stranger.stderr
    assert all(one.stderr.count("\n") == 1 for one in (second, other, stranger))
    assert not (tmp_path / "other.mcap").exists()

    recorder = service("recorder", "-o", path)
    for name, process in {**nodes, "recorder": recorder, "router": router}.items():
        assert process.wait() == 0, f"{name}: {process.stderr}"
    assert f"{path} is complete" in recorder.stderr

    assert here("doctor", path).code == 0
    assert here("run", SCENARIO, *shorter, "--runner", "inline", "-o", inline).code == 0
    assert here("diff", path, inline).code == 0
    assert json.loads(here("info", path, "--json").out)["ticks"] == 40
