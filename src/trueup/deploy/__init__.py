"""What runs beside a robot: trained networks in a control loop, without torch and without a simulator.

Importing this loads numpy only; onnxruntime (extra `run`) is loaded when a model folder is opened.
"""

from trueup.deploy.clock import RealTimeClock as RealTimeClock
from trueup.deploy.compensated_robot import CompensatedIO as CompensatedIO
from trueup.deploy.compensated_robot import CompensatedRobot as CompensatedRobot
from trueup.deploy.compensator import Compensated as Compensated
from trueup.deploy.compensator import Compensator as Compensator
from trueup.deploy.compensator_settings import CompensatorSettings as CompensatorSettings
from trueup.deploy.compensator_settings import Limits as Limits
from trueup.deploy.confidence import Confidence as Confidence
from trueup.deploy.history import History as History
from trueup.deploy.latency import Latency as Latency
from trueup.deploy.loop import LoopReport as LoopReport
from trueup.deploy.loop import run_loop as run_loop
from trueup.deploy.network import Network as Network
from trueup.deploy.predictor import Predictor as Predictor
from trueup.deploy.settings import StreamSettings as StreamSettings
from trueup.deploy.step import Status as Status
from trueup.deploy.step import Step as Step
from trueup.deploy.step import Why as Why
from trueup.deploy.stream import Stream as Stream
