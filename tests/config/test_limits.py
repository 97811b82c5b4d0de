"""Every number in configs and on the command line has limits."""

import math
import typing

import click
import pytest
from pydantic import BaseModel, ValidationError

from semisynth_gl.cli import semisynth_gl
from semisynth_gl.config import Config, Range

DIGITS = "9" * 5000


def sections_below(annotation):
    """Return all sections of an annotation, and the sections below them."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        keys = [field.annotation for field in annotation.model_fields.values() if field.annotation is not Config]
        return {annotation}.union(*map(sections_below, keys))
    return set().union(*map(sections_below, typing.get_args(annotation)))


def types_in(annotation):
    arguments = () if typing.get_origin(annotation) is typing.Literal else typing.get_args(annotation)
    return {each for part in arguments for each in types_in(part)} or {annotation}


FIELDS = [(section, name, field) for section in sections_below(Config) for name, field in section.model_fields.items()]


def is_refused(section, name, value):
    """Tell whether a section refuses a key's value as it is, in lists and in a mapping."""
    for shape in (value, [value], {"chair": value}, [value, value]):
        try:
            section.model_validate({name: shape})
        except ValidationError as error:
            if any(fault["loc"][:1] == (name,) for fault in error.errors()):
                continue
        return False
    return True


def test_every_number_of_a_config_has_limits():
    numbers = [(section, name) for section, name, field in FIELDS if types_in(field.annotation) & {int, float, Range}]
    assert len(numbers) > 60
    values = (10**5000, 10**30, 1e300, -1e300, math.inf, -math.inf, math.nan)
    assert [each for each in numbers for value in values if not is_refused(*each, value)] == []


# The command line


def commands(group=semisynth_gl):
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        yield from commands(command) if isinstance(command, click.Group) else [command]


def test_every_whole_number_of_the_command_line_has_limits():
    """tests/calibration/test_calibrate.py tests the other numbers."""
    types = [(parameter.opts[0], parameter.type) for command in commands() for parameter in command.params]
    parts = [(name, part) for name, kind in types for part in getattr(kind, "types", [kind])]
    numeric = [(name, part) for name, part in parts if isinstance(part, click.types.IntParamType)]
    assert len(numeric) > 15
    for name, kind in numeric:
        for value in (DIGITS, "1" + "0" * 30, "1e300", "inf", "nan", "-1e300"):
            with pytest.raises(click.BadParameter):
                pytest.fail(f"{name} {kind.convert(value, None, None)}")
