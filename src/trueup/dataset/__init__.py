"""Robot logs on disk: one folder, read lazily, written so that nothing finished is lost."""

from trueup.dataset.info import DatasetInfo as DatasetInfo
from trueup.dataset.info import is_dataset as is_dataset
from trueup.dataset.reader import Dataset as Dataset
from trueup.dataset.splits import SPLITS as SPLITS
from trueup.dataset.splits import SplitMatch as SplitMatch
from trueup.dataset.splits import assign_splits as assign_splits
from trueup.dataset.splits import match_splits as match_splits
from trueup.dataset.splits import read_split as read_split
from trueup.dataset.writer import DatasetWriter as DatasetWriter
from trueup.dataset.writer import RunWriter as RunWriter
from trueup.dataset.writer import refuse_occupied as refuse_occupied
from trueup.dataset.writer import refuse_run as refuse_run

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
    "refuse_run",
]
