"""Worlds, tasks and matches by name: from entry points of installed packages, or registered here.

The trainer knows none of them by name.
"""

import contextlib
import inspect
import traceback
from collections.abc import Iterator
from importlib import metadata
from typing import Any

from envs.base import Refusal, World

WORLDS, TASKS, MATCHES = "fntg_jax.worlds", "fntg_jax.tasks", "fntg_jax.matches"

_registered: dict[str, dict[str, Any]] = {WORLDS: {}, TASKS: {}, MATCHES: {}}


class MemberError(Exception):
    """The code of a world or task failed: which, in words.  Its cause is what was raised there."""


@contextlib.contextmanager
def code_of(what: str, *objects: Any) -> Iterator[None]:
    """Raise `MemberError` from an exception that passed through somebody's files.

    Args:
        what: whose code, in words: "world 'mine'".
        objects: functions, or instances of classes, that lie in these files.
    """
    try:
        yield
    except (MemberError, Refusal):
        raise
    except Exception as error:
        frames = {frame.filename for frame in traceback.extract_tb(error.__traceback__)}
        for thing in objects:
            thing = inspect.unwrap(getattr(thing, "func", thing))
            code = thing if inspect.isroutine(thing) else type(thing)
            with contextlib.suppress(TypeError, OSError):  # built in
                if inspect.getfile(code) in frames:
                    raise MemberError(
                        f"the code of {what} failed, in {inspect.getfile(code)}"
                    ) from error
        raise


def register(group: str, name: str, member: Any) -> None:
    """Make an object known under a name in this process, over an entry point of that name.

    Args:
        group: WORLDS, TASKS or MATCHES.
        name: of the member.
        member: what an entry point would name.
    """
    _registered[group][name] = member


def names(group: str) -> list[str]:
    """All names known in a group, sorted.

    Args:
        group: WORLDS, TASKS or MATCHES.
    """
    own = {"bioa"} if group == TASKS else set()  # the trainer's own, see `problem.resolve`
    installed = {e.name for e in metadata.entry_points(group=group)}
    return sorted({*own, *_registered[group], *installed})


def get_world(name: str) -> World:
    """The world of that name.

    Args:
        name: of the entry point.

    Raises ValueError listing the known ones.
    """
    return _get(WORLDS, "env", "worlds", name)


def get_match(name: str) -> Any:
    """The match of that name: options by name -> a match.

    Args:
        name: of the entry point.

    Raises ValueError listing the known ones.
    """
    return _get(MATCHES, "match", "matches", name)


def get_task(name: str) -> Any:
    """The task's factory: options by name -> `envs.base.Task`.

    Args:
        name: of the entry point.

    Raises ValueError listing the known ones.
    """
    return _get(TASKS, "task", "tasks", name)


def _get(group: str, field: str, words: str, name: str) -> Any:
    if name in _registered[group]:
        return _registered[group][name]
    found = {e.name: e for e in metadata.entry_points(group=group)}
    if name not in found:
        raise ValueError(
            f"{field} = {name!r}: known {words} are {', '.join(names(group)) or 'none'}"
        )
    try:
        return found[name].load()
    except Exception as error:  # a package of somebody else
        kind = words.removesuffix("s")
        raise MemberError(f"{kind} {name!r} cannot be imported: {found[name].value}") from error


def get_suite(world: World, suite: str) -> Any:
    """(key, num_scenes) -> scenes.

    Args:
        world: `envs.base.World`.
        suite: one suite, with options where the world's suites take some, "blocked/wall=0.1", or a
            mix with shares, "open:2,blocked:3".

    Raises ValueError naming the unknown suite or option, or the unusable share.
    """
    if suite in world.suites:
        return world.suites[suite]
    if ":" not in suite:
        return world.mix(((suite, 1.0),))
    shares = []
    for part in suite.split(","):
        name, _, share = part.partition(":")
        try:
            shares.append((name, float(share)))
        except ValueError:
            raise ValueError(f"suite = {suite!r}: {part!r} is not NAME:SHARE") from None
    return world.mix(tuple(shares))
