"""Robot logs on disk: one folder, read lazily, written so that nothing finished is lost."""

from trueup.dataset.info import DatasetInfo, is_dataset, refuse_results
from trueup.dataset.reader import Dataset
from trueup.dataset.splits import SPLITS, SplitMatch, assign_splits, match_splits, read_split
from trueup.dataset.writer import DatasetWriter, RunWriter, refuse_occupied, refuse_run

__all__ = [
    "SPLITS",
    "Dataset",
    "DatasetInfo",
    "DatasetWriter",
    "RunWriter",
    "SplitMatch",
    "assign_splits",
    "is_dataset",
    "match_splits",
    "read_split",
    "refuse_occupied",
    "refuse_results",
    "refuse_run",
]
