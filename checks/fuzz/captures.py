"""A small capture: a ROS topic with losses, repetitions and a message that is none, a key without numbers, drops."""

from pathlib import Path

from dynpf_formats.capture.form import Began, Dropped, Outage
from dynpf_formats.capture.reader import read_capture
from dynpf_formats.capture.writer import CaptureWriter, Sample
from dynpf_formats.recording.errors import RecordingError
from dynpf_formats.ros2.attachment import Attachment
from dynpf_formats.ros2.keys import Published
from dynpf_formats.ros2.types import Releases, RosTypes

from checks.fuzz.subjects import command
from checks.fuzz.trial import WrongAnswerError

__all__ = ["mended", "write_capture"]

_TYPE = "std_msgs/msg/String"
_PUBLISHER = b"p" * 16


def write_capture(path: Path) -> Path:
    """Write the capture, a chunk for each message, and return its path."""
    types = RosTypes()
    key = Published("/talk", _TYPE, types.hash(_TYPE)).key(0)
    began = Began(dynpf_version="0", connect="tcp/robot:7447", keys=("**",), domain=0, format="rmw_zenoh", began_ns=0)
    word = types.encode(_TYPE, types.make(_TYPE, "word"))
    samples = [
        Sample(key, word, Attachment(number, number, _PUBLISHER).encode(), "zenoh/bytes", number)
        for number in (1, 2, 4, 4, 3, 8)
    ]
    writer = CaptureWriter(path, began, Releases())
    for sample in (
        *samples,
        Sample(key, b"\0\1", b"", "zenoh/bytes", 9),
        Sample("door", b"open", b"", "text/plain", 9),
    ):
        writer.write(sample)
        writer.flush()
    writer.drop(Dropped(key="door", publisher="", count=3, at_ns=10))
    writer.drop(Dropped.of(key, Attachment(9, 9, _PUBLISHER), 10))
    writer.tally.outages.append(Outage(1, 2))
    writer.close("over", 11)
    return path


def mended(path: Path, output: Path) -> None:
    """Recover a capture; what comes out must be undamaged."""
    try:
        command("recover", path, "-o", output)
        try:
            damage = read_capture(output).damage
        except RecordingError as error:
            raise WrongAnswerError(f"the recovered capture cannot be read: {error}") from error
        if damage:
            raise WrongAnswerError(f"the recovered capture is damaged: {damage[0].text}")
    finally:
        output.unlink(missing_ok=True)
