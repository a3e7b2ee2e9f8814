"""What the C library does with freed memory; other libraries than glibc are left as they are."""

import ctypes
from contextlib import suppress

# Options of glibc's mallopt, and their values: 32 MiB is the most it takes for blocks.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
_KEPT_BYTES, _KEPT_BLOCK_BYTES = 128 << 20, 32 << 20


def keep_freed_memory() -> None:
    """Let this process reuse the memory of freed images.

    By default glibc returns it to the system, which clears every page again for the next image: a
    seventh of the time of scoring frames of 1280x720.
    """
    with suppress(AttributeError, OSError):
        c_library = ctypes.CDLL(None)
        c_library.mallopt(_M_MMAP_THRESHOLD, _KEPT_BLOCK_BYTES)
        c_library.mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)


def return_free_memory() -> None:
    """Return free memory to the operating system.

    glibc keeps the memory that threads have freed, and other threads cannot use it.
    """
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None).malloc_trim(0)
