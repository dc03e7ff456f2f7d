"""How the commands of the pages are made small enough for a test: sizes and durations, never what they mean."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Smaller:
    """Lines that begin with these words and have, or lack, these ones take these options; on this page, if given."""

    command: str
    give: dict[str, str]
    why: str
    has: str = ""
    lacks: str = "\n"
    page: str = ""

    def fits(self, line):
        """Whether it is one of them."""
        text = f"{' '.join(line.words)} "
        asked = self.has in text and self.lacks not in text
        return line.begins(self.command) and asked and self.page in ("", line.page)


# Options that say how much, how long, by how many at a time; `--config` names files of `FILES`, which say the same.
SIZES = {
    *("--scale", "--steps", "--epochs", "--budget", "--goals", "--seconds", "--evaluations", "--duration", "--draws"),
    *("--motions", "--late-ms", "--seeds", "--jobs", "--config"),
}
# And one without which nothing of so few motions would be used.
UNSURE = {"--force"}

# Of two that fit, the later one counts.
TABLE = (
    Smaller("record", {"--jobs": "1"}, "a process more takes longer to start than it saves"),
    Smaller("record", {"--scale": "0.001"}, "a motion of each kind", lacks="animations"),
    Smaller(
        "record", {"--scale": "0.005"}, "3 of train and one of val of both kinds", "data/panda ", page="augmentation"
    ),
    Smaller("record", {"--scale": "0.005"}, "the same", page="learned-corrections"),
    Smaller("record", {"--scale": "0.06"}, "one motion", has="dancebot-animations"),
    Smaller("replay", {"--jobs": "1"}, "DART works in processes, which take seconds to start", has="--engine dart"),
    Smaller("augment train", {"--jobs": "1"}, "threads of networks this small wait for one another"),
    Smaller("augment train", {"--epochs": "1"}, "a training takes hours", lacks="--method moving-average"),
    Smaller("augment sweep", {"--epochs": "1", "--seeds": "2", "--jobs": "1"}, "every training takes hours"),
    Smaller("augment time", {"--seconds": "0.2"}, "200 steps in place of 10,000 and more"),
    Smaller("augment robustness", {"--draws": "1", "--motions": "1", "--jobs": "1"}, "every draw is a replay"),
    Smaller("identify", {"--jobs": "1"}, "threads that are more than cores wait for one another"),
    Smaller("identify", {"--config": "small/identify.yaml"}, "a fit takes minutes", lacks="--config"),
    Smaller("identify runs/arm/dataset", {"--config": "small/models.yaml"}, "the same, with a model that is tried"),
    Smaller("close", {"--jobs": "1", "--config": "small/identify.yaml"}, "as above"),
    Smaller("close", {"--config": "small/gains.yaml"}, "its gains are what is wrong", page="lerobot"),
    Smaller("close", {"--budget": "2s"}, "15 minutes if not given", lacks="--until"),
    Smaller("close", {"--budget": "10s"}, "enough for a moment of every step", has="--budget none"),
    Smaller("demo", {"--budget": "2s", "--jobs": "1"}, "5 minutes if not given"),
    Smaller("gap", {"--jobs": "1"}, "as above", has="--explain"),
    Smaller("compensate train", {"--config": "small/operator.yaml", "--jobs": "1"}, "a training takes an hour"),
    Smaller("compensate train data/slow", {"--config": "small/torques.yaml"}, "the same, of torques"),
    Smaller("fleet", {"--jobs": "1", "--budget": "20s"}, "as above; without a limit if not given"),
    Smaller("policy train", {"--config": "small/policy.yaml", "--jobs": "1"}, "a training takes a quarter of an hour"),
    Smaller("policy train", {"--force": ""}, "so few motions leave the identification unsure", has="--randomize runs/"),
    Smaller("policy grid", {"--config": "small/policy.yaml", "--jobs": "1"}, "so does each of a grid"),
    Smaller("policy grid", {"--steps": "160"}, "as in small/policy.yaml", has="--steps"),
    Smaller("policy eval", {"--goals": "2", "--jobs": "1"}, "100 goals take minutes"),
    Smaller("deploy run", {"--seconds": "0.5"}, "4 seconds for each goal if not given"),
    Smaller("deploy run", {"--goals": "2"}, "they are gone for one after the other", has="--goals"),
    Smaller(
        "deploy run", {"--goals": "5", "--seconds": "2"}, "3 are of train, one of val, one of test", has="--goals 50 "
    ),
    Smaller("deploy run", {"--late-ms": "10000"}, "a machine that tests run on is late", has="--real-time"),
    Smaller("doctor", {"--seconds": "0.3"}, "5 seconds if not given", has="--realtime"),
    Smaller("payload", {"--jobs": "1", "--config": "small/gains.yaml"}, "a fit takes minutes"),
    Smaller("selftest", {"--jobs": "1", "--config": "small/gains.yaml"}, "each is a fit"),
    Smaller("selftest", {"--seeds": "2"}, "as above", has="--seeds"),
    Smaller("design", {"--evaluations": "5", "--duration": "3", "--jobs": "1"}, "each simulates all parameters"),
)

FILES = {
    "identify.yaml": """
fit: {frictionloss: {shared: true}}
models: {}
data: {budget_s: 4.0}
solver: {max_iterations: 10, max_evaluations: 20, tolerance: 0.03}
""",
    "gains.yaml": """
fit: {kp: {shared: true}}
models: {}
data: {budget_s: 4.0}
solver: {max_iterations: 4, max_evaluations: 20, tolerance: 0.03}
""",
    "models.yaml": """
fit: {frictionloss: {shared: true}}
models: {gain: [kp]}
data: {budget_s: 4.0}
solver: {max_iterations: 4, max_evaluations: 20, tolerance: 0.03}
""",
    "operator.yaml": """
network: {kind: operator, hidden: [12], history: 3, features: 4, trunk: [8], sensors: 4, predictor: [8]}
training: {updates: 4, rounds: 1, batch: 8, horizon: 4}
""",
    "torques.yaml": """
network: {kind: mlp, hidden: [8], history: 4}
training: {updates: 4, rounds: 1, batch: 8, horizon: 4}
relative: false
""",
    "policy.yaml": """
reach: {control_hz: 25.0, episode_s: 0.4}
learner: {starts: 40, updates: 1, batch: 16, layers: [16], buffer: 2000}
arms: 4
steps: 160
rounds: 2
""",
}


def smaller(line):
    """The words of a line as they are run, without the first."""
    words = list(line.words[1:])
    for rule in TABLE:
        if rule.fits(line):
            for option, value in rule.give.items():
                if option in words:
                    words[words.index(option) + 1] = value
                else:
                    words += [option, value] if value else [option]
    return words
