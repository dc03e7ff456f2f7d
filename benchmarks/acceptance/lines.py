"""What was asked of each part, line by line, and where the figure comes from."""

from __future__ import annotations

from dataclasses import dataclass

from benchmarks.acceptance.sources import Benchmark, Source, Tests

DONE, SPEED = "done when", "speed"


@dataclass(frozen=True)
class Line:
    """One thing that was asked.

    Attributes:
        part: of trueup.
        kind: `done when` or `speed`.
        asks: what was asked, in short.
        source: what measures it.
        rows: beginnings of the names of its figures, each of at least one; all that the source has, without any.
    """

    part: str
    kind: str
    asks: str
    source: Source
    rows: tuple[str, ...] = ()


FOUNDATION, IDENTIFICATION = "Foundation", "Identification"
HARDWARE, LEARNED = "Virtual hardware and recording", "Learned residuals"

LINES = (
    Line(
        FOUNDATION,
        DONE,
        "In a fresh clone `make demo` and `make test` pass, the tests in less than 15 minutes",
        Benchmark("fresh_clone"),
        ("make ",),
    ),
    Line(FOUNDATION, DONE, "The README's example is a test", Tests(("tests/test_readme.py",))),
    Line(
        FOUNDATION,
        DONE,
        "SO-101: stock model and command as its README says, within 2 %, by import, replay, gap and close",
        Benchmark("references"),
        ("SO-101",),
    ),
    Line(
        FOUNDATION,
        DONE,
        "Double pendulum, 0.5 s windows, commanded torque: as its README says, within 5 %",
        Benchmark("references"),
        ("double pendulum",),
    ),
    Line(
        FOUNDATION,
        DONE,
        "The report in a real browser: curves are drawn, joints and motions can be chosen, no error in the console",
        Tests(("tests/report/test_report_browser.py",)),
    ),
    Line(
        FOUNDATION,
        DONE,
        "Tests on recordings are skipped with a message where there are none, and the others run",
        Benchmark("fresh_clone"),
        ("without recordings",),
    ),
    Line(
        FOUNDATION,
        SPEED,
        "1000 episodes of 500 x 21: write within 3 and read within 2 times plain pyarrow, one at random in 2 ms; "
        "20,000 episodes in less than 400 MB",
        Benchmark("dataset_io"),
    ),
    Line(FOUNDATION, SPEED, "43 SO-101 motions imported in 8 s", Benchmark("import_sage")),
    Line(FOUNDATION, SPEED, "500,000 MCAP messages in no more time than rosbags takes", Benchmark("import_mcap")),
    Line(FOUNDATION, SPEED, "Replay at 0.9 of raw `mujoco.rollout` or faster", Benchmark("replay")),
    Line(FOUNDATION, SPEED, "`trueup gap` with report on 43 motions in 20 s", Benchmark("pipeline")),
    Line(
        IDENTIFICATION,
        DONE,
        "Known parameters are recovered with noise, delay and a wrong start, for every friction model and inertia; "
        "over 40 seeds 95 % intervals cover the truth in 85 to 100 %",
        Tests(("tests/identify/test_recovery.py",)),
    ),
    Line(
        IDENTIFICATION,
        DONE,
        "The ES thesis's experiment on hidden Pandas: error cut by 98 % on every joint",
        Benchmark("thesis"),
        ("robot 0", "robot 1, auto", "robot 2, auto"),
    ),
    Line(
        IDENTIFICATION,
        DONE,
        "SO-101, fitted on train, chosen on val: 0.0130 rad on test, in 10 minutes",
        Benchmark("real_robots"),
        ("SO-101",),
    ),
    Line(
        IDENTIFICATION,
        DONE,
        "Double pendulum, 0.5 s windows: 40 % less than the stock model on test",
        Benchmark("real_robots"),
        ("double pendulum",),
    ),
    Line(
        IDENTIFICATION,
        SPEED,
        "21 parameters, 4 x 2 s of position servos: no slower than mujoco.sysid and scipy, median error no larger",
        Benchmark("identify_servo"),
        ("time, trueup / mujoco.sysid", "time, trueup / scipy", "median error, trueup / "),
    ),
    Line(
        IDENTIFICATION, SPEED, "The same, torque-driven: 5 s, where whole rollouts fail", Benchmark("identify_torque")
    ),
    Line(
        IDENTIFICATION,
        SPEED,
        "49 parameters of 12 joints from a 20 s chirp in 5 min (PACE: 2 h 15 min); 117 parameters run, and an "
        "iteration's cost grows no faster than their number",
        Benchmark("identify_pace"),
    ),
    Line(IDENTIFICATION, SPEED, "2 threads: 1.7 times 1 or better", Benchmark("identify_jobs")),
    Line(IDENTIFICATION, SPEED, "The full friction law at 0.6 of MuJoCo's own rate or faster", Benchmark("friction")),
    Line(
        HARDWARE,
        DONE,
        "A tenth of the papers' data set recorded, replayed in both engines and reported by the documented commands",
        Benchmark("papers_tenth"),
    ),
    Line(
        HARDWARE,
        DONE,
        "Alignment finds known start times within one sample in 99 % of episodes",
        Benchmark("alignment"),
    ),
    Line(
        HARDWARE,
        DONE,
        "Plans keep limits and are free of collision at 1 ms; one joint moves; lines are straight within 1 mm",
        Tests(("tests/record/test_plans.py", "tests/record/test_check.py", "tests/record/test_plansets.py")),
    ),
    Line(
        HARDWARE,
        DONE,
        "Recorded clocks increase; an interrupted recording resumes to the same bytes",
        Tests(("tests/record/test_recorder.py", "tests/stages/test_recording.py", "tests/dataset/test_store_crash.py")),
    ),
    Line(
        HARDWARE,
        DONE,
        "The twin's torque error is 5 to 40 Nm2 in every joint, and grows with the payload",
        Benchmark("panda"),
    ),
    Line(
        HARDWARE,
        DONE,
        "The report shows the payload trend and both simulators",
        Tests(("tests/report/test_report_engines.py",)),
    ),
    Line(
        HARDWARE,
        SPEED,
        "1770 motions planned, executed, recorded, replayed in 15 minutes; 2 processes 1.7 times 1; memory does not "
        "grow with the motions",
        Benchmark("recording"),
    ),
    Line(HARDWARE, SPEED, "Planning and timing of one motion: 50 ms", Benchmark("planning")),
    Line(HARDWARE, SPEED, "The lab with all effects: 100,000 steps/s on a core", Benchmark("lab")),
    Line(HARDWARE, SPEED, "DART's rate beside MuJoCo's is shown", Benchmark("engines")),
    Line(
        LEARNED,
        DONE,
        "Torque MSE cut on every joint: 10 times by the precise and 7 times by the real-time network on multi-joint "
        "motions, 5 times on straight lines, 2.2 times on another unit; position and velocity no worse anywhere",
        Benchmark("augment"),
        ("realeasy", "unit "),
    ),
    Line(
        LEARNED,
        DONE,
        "SO-101, on top of the identified simulator: real-time 0.0105 rad, precise 0.0100 on test",
        Benchmark("augment"),
        ("SO-101",),
    ),
    Line(
        LEARNED,
        DONE,
        "Streaming equals offline prediction, and ONNX equals torch, to 1e-5",
        Tests(("tests/deploy/test_stream.py", "tests/augment/test_networks.py")),
    ),
    Line(
        LEARNED,
        SPEED,
        "One step of the real-time network: half within 20 us, 99 % within 40, 99.9 % within 100; in a loop at 1 kHz "
        "for 60 s no deadline missed by the step",
        Benchmark("streaming"),
    ),
    Line(
        LEARNED,
        SPEED,
        "An epoch of the papers' configuration within 1.3 times a bare torch loop; the default reaches the papers' "
        "error on val in half their time; memory does not grow with the data",
        Benchmark("training"),
    ),
)

# Beginning of a figure's name -> why it misses its bar. A figure that misses without a word here is a defect.
REASONS = {
    "double pendulum: files' joints within 5 %": "The means over files hold; of the single numbers, joint 1 of "
    "trajectory_01 (2.78 against 2.6 deg) and of trajectory_11 (7.96 against 9.2) do not. About 150 variants of the "
    "window, the step, the torque between stamps and the reading were tried: none brings all fourteen within 5 %. The "
    "pendulum is chaotic near upright: over these variants trajectory_11 alone ranges from 7.7 to 10.6 deg.",
    "median error, trueup / ": "All three end in the same minimum, each as near as its tolerance wants, and noise "
    "decides which of them is nearer to the truth by some thousandths: in some rounds it is ours, in others theirs.",
    "Stream.step": "About 2 % of all work on the machine this was measured on takes 1.7 to 2 times as long, a bare "
    "Python loop too, so that the slowest of a hundred steps takes twice the median. The median keeps its bar; on a "
    "machine on which bare matrix-vector products take twice as long, it was 48 us. It would take a core of one's "
    "own, or a step below 16 us, of which onnxruntime alone needs 13.",
    "a whole fit of 21 parameters, 2 threads": "What is left to one thread is the linear algebra of a step and the "
    "choice of the next, a tenth of the time of so small a fit. In six runs the figure was 1.66 to 1.88, while raw "
    "`mujoco.rollout` on the same two cores gave 1.78 to 2.07: the cores share more on some days than on others.",
    "make test: failed": "On the processor of this table a link broke away that stays stuck on others: the push of "
    "one test was within a thousandth of what friction can hold. It pushes with a margin since, and the test says so.",
    "make test, with installation": "The machine of this table takes about twice the time of the one that the bar was "
    "set on; there, earlier on the same day, the same tests took 10.6 min.",
    "tests that failed or were skipped": "One test stops a recording, of motions so few that they were done before. "
    "It records more of them since, and all 130 pass; nothing was wrong with what it tests.",
    "one episode at random, cold shard": "The machine of this table takes twice the time of the one that the bar was "
    "set on, which kept it (two bare matrix-vector products: 11.3 against 5.4 us). A warm shard keeps the bar on both.",
    "replay / raw mujoco.rollout": "Two runs gave 0.89 and 0.90 on one thread, 0.91 and 0.87 on two; earlier on the "
    "same day, on a faster and quieter machine, both kept the bar. What replay adds to a rollout is the reading of "
    "stamps.",
}


# The same in the words of the page. Results keep the reason that was true when they were stored.
EXPLAINED = {
    "double pendulum: files' joints within 5 %": "The means over files keep the bar; joint 1 of trajectory_01 (2.78 "
    "against 2.6 deg) and of trajectory_11 (7.96 against 9.2 deg) do not. None of about 150 variants of window, time "
    "step and reading brings all fourteen within 5 %: the pendulum is chaotic near upright.",
    "median error, trueup / ": "All three solvers end in the same minimum. Which is nearer to the truth by some "
    "thousandths differs from round to round.",
    "Stream.step": "About 2 % of all work on this machine takes 1.7 to 2 times as long, even a bare Python loop. It "
    "takes a dedicated core, or a step below 16 us, of which onnxruntime alone needs 13.",
    "make test: failed": "One test pushed to within a thousandth of the friction, so the link broke away on this "
    "processor. It pushes with a margin since.",
    "make test, with installation": "The bar was set on a machine about twice as fast: 10.6 min on the same day.",
    "tests that failed or were skipped": "A recording ended before the test interrupted it. It records more motions "
    "since, and all 130 tests pass.",
    "one episode at random, cold shard": "The bar was set on a machine twice as fast, which kept it. A warm shard "
    "keeps the bar on both.",
    "replay / raw mujoco.rollout": "A second run gave 0.91; a faster and quieter machine kept the bar on the same day. "
    "Replay also reads the time stamps of the log.",
}


def explained(name: str) -> str:
    """Why a figure misses its bar, in the words of the page; empty if the page has none of its own."""
    return next((text for start, text in EXPLAINED.items() if name.startswith(start)), "")


def reason(name: str) -> str:
    """Why a figure misses its bar; empty where nobody knows."""
    return next((text for start, text in REASONS.items() if name.startswith(start)), "")
