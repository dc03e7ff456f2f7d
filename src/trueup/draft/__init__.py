"""First versions of robot.yaml, from a model and the names that logs have for its joints."""

from trueup.draft.names import Matching, match_names
from trueup.draft.robot import RobotDraft, draft_robot

__all__ = ["Matching", "RobotDraft", "draft_robot", "match_names"]
