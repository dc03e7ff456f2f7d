"""What other processes do in tests; pytest's own modules cannot be imported there."""

import os
import time

from trueup.errors import DataError


def square(number):
    return number**2


def square_slowly(number):
    time.sleep(1.0 if number == 0 else 0.0)
    return number**2


def wait_a_minute_but_for_nothing(number):
    time.sleep(60 if number else 0)


def end(number):
    os._exit(number)


def square_or_end_once(item):
    number, marker = item
    if marker is not None and not marker.exists():
        marker.touch()
        os._exit(1)
    return number**2


def begin_with(word):
    os.environ["BEGUN_WITH"] = word


def begun_with(_):
    return os.environ["BEGUN_WITH"]


def refuse(item):
    raise DataError("cannot", got=item, hint="Do not.")


def square_but_end_for_two(number):
    if number == 2:
        os._exit(1)
    return number**2


def gpus_given(_):
    import ray

    return ray.get_gpu_ids()
