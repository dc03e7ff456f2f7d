"""One module per command: dataset in, results out. The Python API is these functions."""

from trueup.stages.augmenting import Augmented, augment
from trueup.stages.checking import check_setup, refuse_wrong
from trueup.stages.close_steps import Closed, Watch
from trueup.stages.closing import close
from trueup.stages.compensated_replaying import compensated_replay
from trueup.stages.compensating import Compensated, Prepared, compensate, prepare
from trueup.stages.demonstrating import demo, demo_dataset
from trueup.stages.designing import Designed, Foreseen, design
from trueup.stages.drafting import Drafted, draft, keep_draft
from trueup.stages.evaluating import Evaluated, evaluate
from trueup.stages.experimenting import experiment
from trueup.stages.exporting import export_dataset
from trueup.stages.identifying import FITTED, Identified, explain, fit
from trueup.stages.importing import ImportSummary, import_logs, plan_import
from trueup.stages.measuring import Measurement, gap
from trueup.stages.perturbing import robustness
from trueup.stages.recording import RecordSummary, plans_named, record
from trueup.stages.replaying import STOCK, ReplaySummary, replay
from trueup.stages.rigs import CompensatedRig, EngineRig, LabRig, make_rig
from trueup.stages.selftesting import selftest
from trueup.stages.sweeping import sweep
from trueup.stages.timing import time_steps
from trueup.stages.torques import Explained, torque
from trueup.stages.weighing import payload

__all__ = [
    "FITTED",
    "STOCK",
    "Augmented",
    "Closed",
    "Compensated",
    "CompensatedRig",
    "Designed",
    "Drafted",
    "EngineRig",
    "Evaluated",
    "Explained",
    "Foreseen",
    "Identified",
    "ImportSummary",
    "LabRig",
    "Measurement",
    "Prepared",
    "RecordSummary",
    "ReplaySummary",
    "Watch",
    "augment",
    "check_setup",
    "close",
    "compensate",
    "compensated_replay",
    "demo",
    "demo_dataset",
    "design",
    "draft",
    "evaluate",
    "experiment",
    "explain",
    "export_dataset",
    "fit",
    "gap",
    "import_logs",
    "keep_draft",
    "make_rig",
    "payload",
    "plan_import",
    "plans_named",
    "prepare",
    "record",
    "refuse_wrong",
    "replay",
    "robustness",
    "selftest",
    "sweep",
    "time_steps",
    "torque",
]
