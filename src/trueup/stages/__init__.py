"""One module per command: dataset in, results out. The Python API is these functions."""

from trueup.stages.augmenting import Augmented as Augmented
from trueup.stages.augmenting import augment as augment
from trueup.stages.closing import Closed as Closed
from trueup.stages.closing import close as close
from trueup.stages.demonstrating import demo as demo
from trueup.stages.demonstrating import demo_dataset as demo_dataset
from trueup.stages.designing import Designed as Designed
from trueup.stages.designing import Foreseen as Foreseen
from trueup.stages.designing import design as design
from trueup.stages.evaluating import Evaluated as Evaluated
from trueup.stages.evaluating import evaluate as evaluate
from trueup.stages.experimenting import experiment as experiment
from trueup.stages.exporting import export_dataset as export_dataset
from trueup.stages.identifying import FITTED as FITTED
from trueup.stages.identifying import Identified as Identified
from trueup.stages.identifying import explain as explain
from trueup.stages.identifying import fit as fit
from trueup.stages.importing import ImportSummary as ImportSummary
from trueup.stages.importing import import_logs as import_logs
from trueup.stages.importing import plan_import as plan_import
from trueup.stages.measuring import Measurement as Measurement
from trueup.stages.measuring import gap as gap
from trueup.stages.recording import RecordSummary as RecordSummary
from trueup.stages.recording import plans_named as plans_named
from trueup.stages.recording import record as record
from trueup.stages.replaying import STOCK as STOCK
from trueup.stages.replaying import ReplaySummary as ReplaySummary
from trueup.stages.replaying import replay as replay
from trueup.stages.rigs import EngineRig as EngineRig
from trueup.stages.rigs import LabRig as LabRig
from trueup.stages.rigs import make_rig as make_rig
from trueup.stages.timing import time_steps as time_steps

__all__ = [
    "FITTED",
    "STOCK",
    "Augmented",
    "Closed",
    "Designed",
    "EngineRig",
    "Evaluated",
    "Foreseen",
    "Identified",
    "ImportSummary",
    "LabRig",
    "Measurement",
    "RecordSummary",
    "ReplaySummary",
    "augment",
    "close",
    "demo",
    "demo_dataset",
    "design",
    "evaluate",
    "experiment",
    "explain",
    "export_dataset",
    "fit",
    "gap",
    "import_logs",
    "make_rig",
    "plan_import",
    "plans_named",
    "record",
    "replay",
    "time_steps",
]
