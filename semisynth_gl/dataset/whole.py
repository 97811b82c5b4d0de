"""The files about a whole dataset, beside its shards: what they hold, and which of them a finished dataset lacks."""

import os
from collections.abc import Mapping
from typing import Any

from semisynth_gl.dataset.begun import read_object
from semisynth_gl.dataset.places import Place
from semisynth_gl.dataset.plan import Plan
from semisynth_gl.dataset.schema import CARD, CROISSANT, INDEX, PLAN


def plan_document(plan: Plan, beginning: Mapping[str, Any]) -> dict[str, Any]:
    """Return what plan.json says of a dataset that began with an index or a plan.json of these values."""
    return {key: beginning[key] for key in (*plan.values(), "sources") if key in beginning}


def lists_of(plan: Plan) -> dict[str, bytes]:
    """Return the contents of the layout's lists of pairs, by name."""
    return {name: data for split in plan.splits for name, data in plan.lists(plan.keys(split)).items()}


def links_of(plan: Plan) -> dict[str, str]:
    """Return the targets of the layout's links, relative to each link's folder, by name."""
    return {name: target for split in plan.splits for name, target in plan.links(plan.keys(split)).items()}


def lost_files(place: Place, plan: Plan) -> list[str]:
    """Return which files, links and folders about the whole dataset are missing, cut off, or not its plan's.

    A card or a Croissant file with other contents is not lost: users add to them. Nor is a folder in the place of
    a link, as a copy without links has it.

    Raises:
        ReadError: where a link, a folder or the like stands in the place of a file.
    """
    index = read_object(place, INDEX)
    if index is None:
        return [INDEX]
    lost = [PLAN] if read_object(place, PLAN) != plan_document(plan, index) else []
    lost += [name for name in (CARD, CROISSANT) if place.size(name) is None]
    lost += [name for name, data in lists_of(plan).items() if place.size(name) is None or place.read(name) != data]
    if place.local is not None:
        for name, target in links_of(plan).items():
            path = place.path(name)
            if not os.path.lexists(path) or (path.is_symlink() and os.readlink(path) != target):  # noqa: PTH115
                lost.append(name)
        lost += [name for name in plan.folders if not place.path(name).is_dir()]
    return lost
