"""Where memory is short, codecs do not end the process or call a sound file damaged, and fewer threads do the work."""

import subprocess
import sys

import pytest

from formats.test_image_kinds import needs

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="the address space is limited on Linux"),
]

LIMITED = """
import resource, numpy as np
soft, hard = resource.getrlimit(resource.RLIMIT_AS)
def outcome(job, mebibytes):
    pages = int(open("/proc/self/statm").read().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + (mebibytes << 20), hard))
    try:
        return job()
    except MemoryError:
        return "MemoryError"
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
"""
CODEC = """
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.image.writing import write_image
from beltrami_cli.formats.image.decoded_image import new_image
slopes = np.linspace(0, 255, 1024 * 1024 * 4).reshape(1024, 1024, 4).astype(np.uint8)
def encoded(pixels):
    if {codec!r} != "etc1s":
        return write_image(new_image(pixels, "x"), pixels, suffix={suffix!r}).data
    import alktx2
    return alktx2.encode_raw_rgba_to_ktx2(pixels.tobytes(), *pixels.shape[:2], True, codec="etc1s", srgb=True)
small = read_image(encoded(slopes[:32, :32]), "x" + {suffix!r})
large = encoded(slopes)
write_image(small, small.pixels)
for mebibytes in (0, 8, 16, 32, 64):
    print(outcome(lambda: read_image(large, "x" + {suffix!r}) and "done", mebibytes))
    print(outcome(lambda: write_image(small, slopes) and "done", mebibytes))
"""
THREADS = """
from beltrami_cli import smooth_image
colours = np.random.default_rng(0).random((64, 64, 3), np.float32)
kernel = {"iterations": 1, "t": 4.0, "beta": 10.0, "patches": "off"}
one = smooth_image(colours, threads=1, **kernel).colours  # whose stack is kept for the next thread
print(outcome(lambda: np.array_equal(smooth_image(colours, threads=8, **kernel).colours, one), 4))
"""

FIRST_EXCEPTION = """
import ctypes
from beltrami_cli import _native
libc = ctypes.CDLL(None)
libc.malloc.restype, libc.malloc.argtypes, libc.free.argtypes = ctypes.c_void_p, [ctypes.c_size_t], [ctypes.c_void_p]
samples = 1 << 14
arguments = (
    np.zeros((samples, 3), np.uint8), np.arange(samples, dtype=np.int32), np.zeros((samples, 3), np.float32),
    np.arange(3, dtype=np.int32), 1,
)
_native.store_colours(*arguments)  # The stack of its thread is kept for the next one.
small = range(24, 1024, 16)
blocks = [libc.malloc(size) for size in small]
def starved():
    for size in (1 << 20, 1 << 16, 1 << 12, *reversed(small)):
        while libc.malloc(size):
            pass
    for block in blocks:
        libc.free(block)  # for this thread, to start another; the others see nothing of it
    return _native.store_colours(*arguments)
print(outcome(starved, 0))
"""


def printed(program):
    # -P: the checkout, where tests run, has no compiled part if the package is installed elsewhere.
    arguments = [sys.executable, "-P", "-c", LIMITED + program]
    run = subprocess.run(arguments, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    return run.stdout.split()


@pytest.mark.parametrize(
    ("codec", "suffix"),
    [
        pytest.param("etc1s", ".ktx2", marks=needs("ktx2")),
        pytest.param("uastc", ".ktx2", marks=needs("ktx2")),
        pytest.param("avif", ".avif", marks=needs("avif")),
    ],
)
def test_codecs_without_memory_raise_what_the_command_reports(codec, suffix):
    outcomes = printed(CODEC.format(codec=codec, suffix=suffix))
    assert len(outcomes) == 10
    assert set(outcomes) <= {"done", "MemoryError"}


def test_threads_that_cannot_be_started_leave_the_work_to_others():
    assert printed(THREADS) == ["True"]


def test_a_thread_left_without_any_memory_raises_an_exception_instead_of_ending_the_process():
    assert printed(FIRST_EXCEPTION) == ["MemoryError"]
