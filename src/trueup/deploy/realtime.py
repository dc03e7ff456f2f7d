"""A process that is in time: pinned, with a priority, its memory locked; and whether a machine is made for that.

Realeasy runs its loops in a container with real-time priorities on a PREEMPT_RT kernel; this is what a process itself
can do about it on Linux, and what it can see of its host.
"""

from __future__ import annotations

import ctypes
import os
import platform
import resource
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from trueup.errors import ConfigError

# sys/mman.h
_MCL_CURRENT, _MCL_FUTURE = 1, 2
_WHOLE_SECOND_US = 1_000_000


@dataclass(frozen=True)
class RealTimeSettings:
    """What a control loop asks of its operating system.

    Attributes:
        priority: of SCHED_FIFO, 1 to 99; None for the ordinary scheduler. 80 is above the kernel's threads of
            interrupts (50), and below what must never wait (99).
        cpus: cores that it runs on; None for all.
        lock_memory: no page of it is ever written to swap or read for the first time in the loop.

    Raises:
        ConfigError: no such priority or core.
    """

    priority: int | None = None
    cpus: tuple[int, ...] | None = None
    lock_memory: bool = False

    def __post_init__(self) -> None:
        """Refuse what no system has."""
        if self.priority is not None and not 1 <= self.priority <= 99:
            raise ConfigError("a real-time priority", got=self.priority, expected="1 to 99")
        there = set(range(os.cpu_count() or 1))
        if self.cpus is not None and not (self.cpus and set(self.cpus) <= there):
            raise ConfigError("cores to run on", got=list(self.cpus), expected=f"some of {sorted(there)}")

    def apply(self) -> None:
        """To this process and the threads that it starts from now on.

        Raises:
            ConfigError: the system does not allow it; the hint says how it would.
        """
        if self.cpus is not None:
            os.sched_setaffinity(0, self.cpus)
        if self.lock_memory:
            _lock_memory()
        if self.priority is not None:
            try:
                os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(self.priority))
            except PermissionError as error:
                raise ConfigError(
                    f"no real-time priority {self.priority}",
                    got=error.strerror,
                    hint="Allow it: `ulimit -r 99` from /etc/security/limits.conf, or docker run --ulimit rtprio=99 "
                    "--cap-add SYS_NICE.",
                ) from error


def _lock_memory() -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE):
        raise ConfigError(
            "memory cannot be locked",
            got=os.strerror(ctypes.get_errno()),
            hint="Allow it: `ulimit -l unlimited` from /etc/security/limits.conf, or docker run --ulimit memlock=-1.",
        )


@dataclass(frozen=True)
class HostCheck:
    """One thing that a loop in real time needs of its host.

    Attributes:
        what: it is.
        found: here.
        good: whether it is as it should be; None where the machine does not say.
        hint: what to do if it is not.
    """

    what: str
    found: str
    good: bool | None
    hint: str = ""


def host_checks(root: Path = Path("/")) -> tuple[HostCheck, ...]:
    """What can be seen of the host, from `/proc`, `/sys` and the limits of this process.

    Args:
        root: where these folders are.
    """
    rtprio, _ = _limits("RLIMIT_RTPRIO")
    memlock, _ = _limits("RLIMIT_MEMLOCK")
    whole = os.geteuid() == 0
    isolated = _text(root / "sys/devices/system/cpu/isolated")
    governors = {_text(path) for path in root.glob("sys/devices/system/cpu/cpu[0-9]*/cpufreq/scaling_governor")}
    runtime = _text(root / "proc/sys/kernel/sched_rt_runtime_us")
    swaps = _text(root / "proc/swaps").splitlines()[1:]
    clock = _text(root / "sys/devices/system/clocksource/clocksource0/current_clocksource")
    version = _text(root / "proc/version") or platform.version()
    preempt = _text(root / "sys/kernel/realtime") == "1" or "PREEMPT_RT" in version
    return (
        HostCheck(
            "kernel",
            "PREEMPT_RT" if preempt else "without PREEMPT_RT",
            preempt,
            "Install a kernel with PREEMPT_RT (Debian: linux-image-rt-amd64; Ubuntu: `pro enable realtime-kernel`).",
        ),
        HostCheck(
            "real-time priorities",
            "root" if whole else f"up to {rtprio}",
            whole or rtprio >= 80,
            "In /etc/security/limits.conf: `@realtime - rtprio 99`, and join that group; in Docker --ulimit rtprio=99.",
        ),
        HostCheck(
            "memory that can be locked",
            "unlimited" if memlock < 0 else f"{memlock // 1024} kB",
            memlock < 0 or whole,
            "In /etc/security/limits.conf: `@realtime - memlock unlimited`; in Docker --ulimit memlock=-1.",
        ),
        HostCheck(
            "cores kept free",
            isolated or "none",
            bool(isolated),
            "On the kernel's command line: isolcpus=3 nohz_full=3 rcu_nocbs=3; then --cpu 3.",
        ),
        HostCheck(
            "clock rate of the cores",
            ", ".join(sorted(governors)) or "not said",
            governors == {"performance"} if governors else None,
            "`cpupower frequency-set -g performance`; deep idle states off in the BIOS.",
        ),
        HostCheck(
            "share for real-time threads",
            "all" if runtime == "-1" else f"{int(runtime) / _WHOLE_SECOND_US:.0%}" if _number(runtime) else "not said",
            runtime == "-1" if _number(runtime) else None,
            "`sysctl kernel.sched_rt_runtime_us=-1`, if a loop may use all of a core.",
        ),
        HostCheck("swap", f"{len(swaps)} areas" if swaps else "none", not swaps, "`swapoff -a`, or lock memory."),
        HostCheck(
            "clock",
            clock or "not said",
            clock == "tsc" if clock else None,
            "The processor's own counter, tsc, is read fastest; virtual machines often have another.",
        ),
    )


def _limits(name: str) -> Sequence[int]:
    kind = getattr(resource, name, None)  # macOS has no priorities of this kind
    return (0, 0) if kind is None else resource.getrlimit(kind)


def _number(text: str) -> bool:
    return text.removeprefix("-").isdigit()


def _text(path: Path) -> str:
    try:
        return path.read_text().strip()
    except OSError:
        return ""
