"""What to tell XLA before it starts: called by the command line and the experiments.

Importing the library changes nothing.  `configure` must run before jax first computes.
"""

import os
import stat
from pathlib import Path

# On CPU these make one compiled function of a whole roll-out scan and let its step write
# several outputs from one vector loop; the paper's learning run went from 0.24 s to 0.14 s
# (2 cores, jax 0.10.2; `experiments/benchmark.py` prints both).  XLA ignores extra options that
# it does not know.
_CPU_EXTRA = "xla_cpu_use_multi_output_fusion,xla_cpu_small_while_loop_byte_threshold=10000000"
_FLAGS = {
    "--xla_backend_extra_options": _CPU_EXTRA,
    "--xla_cpu_prefer_vector_width": "512",
}

# `compiler_options` of jit for programs with a backward pass through the roll-out.  Fused into
# kernels with several outputs, as the flags above ask for, a third of its loops do not vectorise
# on CPU.  Elsewhere there is no such pass to leave out.
GRADIENT_OPTIONS = {"xla_disable_hlo_passes": "cpu_multi_output_fusion"}


def configure(num_cpu_devices: int = 1) -> None:
    """Set XLA's CPU flags, the number of CPU devices and the persistent compilation cache.

    Flags that the user has set in XLA_FLAGS stay; FNTG_XLA_FLAGS=off leaves all alone.
    FNTG_CACHE=off switches the cache off; JAX_COMPILATION_CACHE_DIR moves it.

    Args:
        num_cpu_devices: that JAX shall have.
    """
    if os.environ.get("FNTG_XLA_FLAGS") != "off":
        flags = os.environ.get("XLA_FLAGS", "")
        missing = [f"{k}={v}" for k, v in _FLAGS.items() if k not in flags]
        os.environ["XLA_FLAGS"] = " ".join([flags, *missing]).strip()
    import jax

    if num_cpu_devices > 1 and "xla_force_host_platform_device_count" not in os.environ.get(
        "XLA_FLAGS", ""
    ):
        jax.config.update("jax_num_cpu_devices", num_cpu_devices)
    if os.environ.get("FNTG_CACHE") != "off" and "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        folder = cache_dir()
        if folder is not None:
            jax.config.update("jax_compilation_cache_dir", str(folder))
            jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


def cache_dir() -> Path | None:
    """The user's private cache folder, made if need be; None where there can be none.

    Compiled programs are code: a folder that somebody else can write to is not used.
    """
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folder = base / "fntg-jax" / "xla"
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        info = folder.stat()
    except OSError:
        return None
    private = not info.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return folder if private and info.st_uid == os.getuid() else None
