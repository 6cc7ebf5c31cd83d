"""A made-up log of a laser scanner that drives along a room, with its map."""

from pathlib import Path

from dynpf_lab.cli.main import main
from dynpf_services.scenario.played_log import PlayedLog

MAP = "image: house.pgm\nresolution: 0.5\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
HOUSE = b"P5\n40 40\n255\n" + bytes(0 if {0, 39} & {x, y} else 254 for y in range(40) for x in range(40))


def laser_log(folder: Path) -> PlayedLog:
    lines = []
    for second in range(24):
        x, time = 5 + 0.2 * second, f"{second}.0 h {second}.0"
        ranges = " ".join(f"{max(0.5, 10 - abs(angle) / 15):.2f}" for angle in range(-90, 90))
        lines += [f"ODOM {x} 10 0 0 0 0 {time}", f"FLASER 180 {ranges} {x} 10 0 {x} 10 0 {time}"]
        lines += [f"TRUEPOS {x} 10 0 {x} 10 0 {time}"] if second == 0 else []
    (folder / "log.txt").write_text("\n".join(lines))
    (folder / "house.yaml").write_text(MAP)
    (folder / "house.pgm").write_bytes(HOUSE)
    words = ["import", "carmen", str(folder / "log.txt"), "--range-max", "60", "--map", str(folder / "house.yaml")]
    assert main([*words, "-o", str(folder / "log.mcap")]) == 0
    return PlayedLog(folder / "log.mcap")
