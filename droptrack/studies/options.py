"""The options of ``droptrack track``, given for all videos of a study and for each."""

import difflib
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from droptrack.errors import DroptrackError
from droptrack.pipeline.config import TrackingConfig

if TYPE_CHECKING:  # it takes longer to import than all else here
    from droptrack.analysis.choice import Asked

Given = bool | tuple[str, ...]  # a flag, or the words after an option
ANALYSE = "analyse"  # the option that is no option of ``droptrack track``
YES, NO = ("yes", "true", "1", "on", "x"), ("no", "false", "0", "off")
# of each of these one is given: that of a single video takes the place of all that others say
INSTEAD = (("um_per_px", "known_length"), ("size", "scale", "diameter"))
WITH_COMMAS = ("expect_velocity", "known_length", "region", "cells")
DECIMAL_COMMA = re.compile(r"-?\d+,\d+", re.ASCII)
ALIKE = 0.8  # how alike a column's name and an option's are where one is taken for a slip


@dataclass(frozen=True)
class VideoOptions:
    """The options that a video may have, by their names in Python.

    `command`: that of ``droptrack track``, as Typer makes it, and ANALYSE. `configured` parses a
    command line without it, `asked_for` what stands after it. `without`: options that a study has
    no use for.
    """

    command: Any
    configured: Callable[[list[str]], TrackingConfig]
    asked_for: "Callable[[Sequence[str]], tuple[Asked, ...]]"
    without: Collection[str]
    _parameters: dict[str, Any] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        options = {
            one.name: one
            for one in self.command.params
            if one.param_type_name == "option" and one.name not in {*self.without, "help"}
        }
        object.__setattr__(self, "_parameters", options)

    def given(self, context: Any) -> dict[str, Given]:
        """Those that stand on the command line of a context, which has all of them."""
        return {
            name: _given(parameter, context.params[name])
            for name, parameter in self._parameters.items()
            if getattr(context.get_parameter_source(name), "name", "") == "COMMANDLINE"
        }

    def name_of(self, column: str) -> str | None:
        """The option that a column of a list is of; None of a column of the user's own.

        Raises DroptrackError for what looks like an option that there is not.
        """
        name = column.lower().lstrip("-").replace("-", "_").replace(" ", "_")
        name = {"no_shape": "shape"}.get(name, name)
        if name in self._parameters:
            return name
        if name in self.without or column.startswith("-"):
            raise DroptrackError(f"column {column!r}: is no option that single videos have")
        near = difflib.get_close_matches(name, self._parameters, 1, ALIKE)
        if near:
            raise DroptrackError(
                f"column {column!r}: is no option; is {near[0]} meant? A column of your own needs "
                "another name"
            )
        return None

    def of_cell(self, name: str, text: str, *, decimal_comma: bool) -> Given:
        """What a cell of a list says of an option; raises DroptrackError for what cannot be."""
        parameter = self._parameters[name]
        if parameter.is_flag:
            if text.lower() in YES:
                return True
            if text.lower() in NO:
                return False
            raise DroptrackError(f"{name} {text!r}: should be yes or no")
        if name == ANALYSE:
            return tuple(part.strip() for part in text.split("|"))
        if decimal_comma and name not in WITH_COMMAS and DECIMAL_COMMA.fullmatch(text):
            text = text.replace(",", ".")
        several = parameter.nargs != 1 or parameter.multiple
        return tuple(text.split() if several else [text])

    def config(self, video: str, options: Mapping[str, Given]) -> TrackingConfig:
        """The configuration of a video; raises DroptrackError for what cannot be."""
        tracking = {name: given for name, given in options.items() if name != ANALYSE}
        return self.configured([*self.words(tracking), "--", video])

    def analyses(self, options: Mapping[str, Given]) -> "tuple[Asked, ...]":
        """The analyses of a video; raises DroptrackError for what cannot be."""
        given = options.get(ANALYSE)
        return self.asked_for(given) if isinstance(given, tuple) else ()

    def words(self, options: Mapping[str, Given]) -> list[str]:
        """The command line that options stand for."""
        words: list[str] = []
        for name, given in options.items():
            parameter = self._parameters[name]
            if given is True:
                words.append(parameter.opts[0])
            elif given is False:
                words += parameter.secondary_opts[:1]  # none: left out is no
            elif parameter.multiple:
                words += [word for one in given for word in (parameter.opts[0], one)]
            else:
                words += [parameter.opts[0], *given]
        return words


def merged(common: Mapping[str, Given], own: Mapping[str, Given]) -> dict[str, Given]:
    """The options of a video: its own, and of those for all what they do not replace."""
    replaced = {name for group in INSTEAD if set(group) & own.keys() for name in group}
    return {**{name: given for name, given in common.items() if name not in replaced}, **own}


def _given(parameter: Any, value: Any) -> Given:
    if parameter.is_flag:
        return bool(value)
    if parameter.nargs != 1 or parameter.multiple:
        return tuple(str(part) for part in value)
    return (str(getattr(value, "value", value)),)
