"""A stretch of a log at rest where no phase says that there is one."""

from __future__ import annotations

from imuarray.calibrate.poses import find_poses
from imuarray.characterise.stretch import Stretch, choose_stretch
from imuarray.errors import CalibrationError
from imuarray.log import Log


def longest_rest(log: Log, phase: str | None = None) -> Stretch | None:
    """The longest pose that the sensors show; None if none shows, or a `phase` is asked for or says it rests."""
    if phase is not None or choose_stretch(log, None).phase is not None:
        return None
    try:
        poses = [pose.phase for pose in find_poses(log)]
    except CalibrationError:
        return None
    longest = max(poses, key=lambda pose: pose.end_ns - pose.start_ns, default=None)
    chosen_by = "the longest at rest, as the sensors show: no phase says so"
    return longest and Stretch(longest.start_ns, longest.end_ns, longest.name, "", chosen_by)
