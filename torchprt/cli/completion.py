"""What the Tab key offers after an option: the words it takes, and files where it takes those too."""

from __future__ import annotations

import copy
import glob
import inspect
import os
from collections.abc import Callable, Sequence
from typing import Annotated, get_args

from typer.models import OptionInfo

from torchprt.cli import environments, options, picture_options, plan

# By the name of the parameter, after that of the verb where verbs differ. After all other options shells offer files.
WORDS: dict[str, Sequence[str]] = {
    "albedo": ("vertex",),
    "backdrop": ("transparent", *picture_options.COLOURS),
    "bits": ("8", "16", "32"),
    "bounces": ("auto", "0", "1", "2", "inf"),
    "export eye": ("point", "direction"),
    "export pose": ("frames", "positions"),
    "frame": options.FRAMES,
    "least": plan.LEAST,
    "method": options.METHODS,
    "projection": options.PROJECTIONS,
    "export source": ("light", "environment"),
    "runtime": plan.RUNTIMES,
    "show": ("radiance", "sight"),
    "tone": picture_options.TONES,
    "window": options.WINDOWS,
}
WORDS_AND_FILES: dict[str, Sequence[str]] = {
    "importance": ("natural",),
    "light": environments.BUILT_IN,
}


def completed(verb: Callable[..., None]) -> inspect.Signature:
    """The signature of a verb in which these options complete their words."""
    signature = inspect.signature(verb, eval_str=True)
    return signature.replace(parameters=[_completed(each, verb.__name__) for each in signature.parameters.values()])


def _completed(parameter: inspect.Parameter, verb: str) -> inspect.Parameter:
    base, *about = get_args(parameter.annotation)
    for name in (f"{verb} {parameter.name}", parameter.name):
        words, files = WORDS.get(name) or WORDS_AND_FILES.get(name), name in WORDS_AND_FILES
        if words and isinstance(about[0], OptionInfo):
            informed = copy.copy(about[0])
            informed.autocompletion = _offering(words, files)
            return parameter.replace(annotation=Annotated[base, informed])
    return parameter


def _offering(words: Sequence[str], files: bool) -> Callable[[str], list[str]]:
    def offer(incomplete: str) -> list[str]:
        found = [word for word in words if word.startswith(incomplete)]
        if files:
            names = sorted(glob.glob(glob.escape(incomplete) + "*"))
            found += [name + os.sep if os.path.isdir(name) else name for name in names]
        return found

    return offer
