"""A metric of one's own: how high the object flies."""

from analysis.metrics import OBJECT
from analysis.metrics.metric import NAN, Metric
from analysis.records import Record


def apex(record: Record) -> float:
    """Greatest height of the object's centre of mass above where it starts."""
    trajectory = record.run.state.trajectory
    if trajectory is None:
        return NAN
    heights = trajectory.com[:, 2]
    return float(heights.max() - heights[0])


METRIC = Metric("apex", "apex", "m", "", apex, OBJECT)
