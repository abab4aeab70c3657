"""`fntg doctor`: what is installed, and whether it is what was tested."""

import dataclasses
import os
import platform
from importlib import metadata

from fntg_jax.commands.cli import parse
from fntg_jax.running import xla


@dataclasses.dataclass(frozen=True)
class DoctorOptions:
    """Versions against the ranges that fntg-jax declares, devices, compilation cache, rendering
    back end; worlds, tasks and matches by name.  Exit status 1 when a package is missing or outside
    its range, else 0.

    Attributes:
        world: only run the conformance suite on this world (minutes where compiling takes them);
            exit status 1 where it breaks a law.
        task: the same for a task.
        match: the same for a match.
    """

    world: str = ""
    task: str = ""
    match: str = ""


def main(argv: list[str]) -> None:
    options = parse(DoctorOptions, argv, "doctor")
    xla.configure()
    if options.world or options.task or options.match:
        raise SystemExit(0 if _conforms(options) else 1)
    healthy = True
    print(f"fntg-jax {metadata.version('fntg-jax')}, Python {platform.python_version()}")
    print(f"{platform.system()} {platform.machine()}, {os.cpu_count()} CPUs\n")
    print(f"{'package':18s}{'installed':14s}{'tested':22s}")
    for name, tested, installed, optional in packages():
        fits = installed is not None and tested.contains(installed, prereleases=True)
        verdict = "ok" if fits else "OUTSIDE the tested range" if installed else "not installed"
        if installed is None and optional:
            verdict = f"not installed (optional: {optional})"
        healthy &= fits or (installed is None and bool(optional))
        print(f"{name:18s}{installed or '-':14s}{str(tested) or 'any':22s}{verdict}")
    print()
    for line in (*_devices(), _cache(), *_rendering(), *_deadlock(), *_members()):
        print(line)
    raise SystemExit(0 if healthy else 1)


def _members() -> list[str]:
    from fntg_jax.running import registry

    return [
        f"{what}: {', '.join(registry.names(group))}"
        for what, group in (
            ("worlds", registry.WORLDS),
            ("tasks", registry.TASKS),
            ("matches", registry.MATCHES),
        )
    ]


def _conforms(options: DoctorOptions) -> bool:
    """Print what the conformance suites find; whether nothing is wrong."""
    from fntg_jax.running import conformance, problem, registry, settings

    checks = []
    if options.world:
        world = registry.get_world(options.world)
        own = (world.make, *world.suites.values())
        with registry.code_of(f"world {options.world!r}", *own):
            own = (*own, world.make())
        checks.append((f"world {options.world!r}", own, conformance.world(world)))
    if options.task:
        resolved = problem.resolve(settings.TrainConfig(task=options.task))
        bound = resolved.task_of(resolved.traced()._replace(scenes=resolved.scenes()[0]))
        checks.append((f"task {options.task!r}", (bound.fitness,), conformance.task(bound)))
    if options.match:
        make = registry.get_match(options.match)
        with registry.code_of(f"match {options.match!r}", make):
            match = make()
        checks.append((f"match {options.match!r}", (match,), conformance.match(match)))
    right = True
    for what, own, suite in checks:
        print(what)
        with registry.code_of(what, *own):
            for check in suite:
                right &= not check.wrong
                verdict = f"WRONG: {check.wrong}" if check.wrong else "ok"
                print(f"  {check.what:58s}{verdict}", flush=True)
    return right


def packages() -> list[tuple]:
    """(name, tested range, installed version or None, extras or "") of all that fntg-jax requires,
    from its own package metadata; tools for its development are left out."""
    from packaging.requirements import Requirement

    found: dict[str, tuple] = {}
    for text in metadata.requires("fntg-jax") or []:
        requirement = Requirement(text)
        extra = str(requirement.marker).partition('extra == "')[2].partition('"')[0]
        if extra == "dev":
            continue
        try:
            installed = metadata.version(requirement.name)
        except metadata.PackageNotFoundError:
            installed = None
        name, tested = requirement.name, requirement.specifier
        if name in found:  # asked for by another extra, too
            before = found[name][3]
            extra = f"{before}, {extra}" if before and extra else ""
            tested = found[name][1] & tested
        found[name] = (name, tested, installed, extra)
    return list(found.values())


def _devices() -> list[str]:
    import jax

    try:
        return [f"device: {d.platform} {d.device_kind}" for d in jax.devices()]
    except RuntimeError as error:
        return [f"device: none usable ({' '.join(str(error).split())})"]


def _cache() -> str:
    if os.environ.get("FNTG_CACHE") == "off":
        return "compilation cache: off (FNTG_CACHE)"
    folder = os.environ.get("JAX_COMPILATION_CACHE_DIR") or xla.cache_dir()
    return f"compilation cache: {folder or 'none (no private folder can be made)'}"


def _has(package: str) -> bool:
    try:
        metadata.version(package)
    except metadata.PackageNotFoundError:
        return False
    return True


def _rendering() -> list[str]:
    if not _has("mujoco"):
        return ["rendering: MuJoCo is not installed; HTML, GIF and WebP replays do without it"]
    backend = os.environ.get("MUJOCO_GL")
    if backend:
        return [f"rendering: MUJOCO_GL={backend}"]
    if platform.system() == "Linux" and not os.environ.get("DISPLAY"):
        return ["rendering: no display; MuJoCo draws with EGL, or as MUJOCO_GL says (osmesa)"]
    return ["rendering: MuJoCo's default for this display"]


def _deadlock() -> list[str]:
    import jax

    few = jax.default_backend() == "cpu" and (os.cpu_count() or 1) <= 2
    if not (few and _has("mujoco-mjx")) or os.environ.get("NPROC") == "1":
        return []
    return [
        "note: on a CPU with 2 cores jaxlib can hang for ever at 0 % CPU when MuJoCo's default "
        "integrator settings run in batches; NPROC=1 in the environment avoids it"
    ]
