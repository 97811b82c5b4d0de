"""How long it takes to read each kind of attachment back: with its components alone, as renderers do, or with all four.

    python benchmarks/readback.py --json readback.json

Drivers of GPUs may copy four components in one piece and pick three of them one by one. A turn reads every attachment
in every way once, after the GPU has finished; the table has the medians of the turns.
"""

import json
import sys
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
from timing import alternated

from semisynth_gl.bench.summary import machine_facts, markdown
from semisynth_gl.render.backends import is_software
from semisynth_gl.render.context import open_context
from semisynth_gl.render.readers import PixelBuffers, read_array


class Attachment(NamedTuple):
    """What is read: its name, how many components it has and how many of them are wanted, and moderngl's type."""

    name: str
    components: int
    wanted: int
    kind: str


ATTACHMENTS = (
    Attachment("image, RGBA8", 4, 3, "f1"),
    Attachment("disparity, R32F", 1, 1, "f4"),
    Attachment("normals, RGBA32F", 4, 3, "f4"),
    Attachment("mask, R8UI", 1, 1, "u1"),
    Attachment("instances, R16UI", 1, 1, "u2"),
)


def measure(width_px: int, height_px: int, repeats: int) -> dict[str, Any]:
    """Time each way of each attachment; see the module."""
    context = open_context("egl")
    gl, viewport = context.gl, (0, 0, width_px, height_px)
    calls: dict[str, Callable[[], object]] = {}
    rows: dict[str, dict[str, Any]] = {}
    with ExitStack() as stack:
        stack.callback(context.release)
        buffers = PixelBuffers()
        for each in ATTACHMENTS:
            target = gl.framebuffer([gl.texture((width_px, height_px), each.components, dtype=each.kind)])
            for read in sorted({each.wanted, each.components}):

                def into_memory(target: Any = target, each: Attachment = each, read: int = read) -> None:  # noqa: ANN401 - of moderngl
                    array = read_array(target, viewport, 0, each.kind, read)
                    if read != each.wanted:
                        np.ascontiguousarray(array[..., : each.wanted])

                def into_buffer(target: Any = target, each: Attachment = each, read: int = read) -> None:  # noqa: ANN401
                    buffers.fill(target, viewport, 0, each.kind, read)
                    gl.finish()

                for way, call in (("memory", into_memory), ("pixel buffer", into_buffer)):
                    name = f"{each.name}, {read} into {way}"
                    calls[name] = partial(_after_drawing, gl, target, call)
                    rows[name] = {"attachment": each.name, "components": read, "into": way}
        for call in calls.values():  # the first one allocates
            call()
        seconds = alternated(calls, repeats)
        buffers.release()
        facts = context.facts
    return {
        "size_px": [width_px, height_px],
        "repeats": repeats,
        "machine": machine_facts() | facts | {"software": is_software(facts["renderer"])},
        "rows": [row | {"ms": 1000 * float(np.median(seconds[name]))} for name, row in rows.items()],
    }


def _after_drawing(gl: Any, target: Any, call: Callable[[], None]) -> None:  # noqa: ANN401 - moderngl's
    """Call, with the context idle and its framebuffer's content new."""
    target.clear(0.25, 0.5, 0.75, 1.0)
    gl.finish()
    call()


def headline(report: Mapping[str, Any]) -> str:
    """Return what was measured where."""
    width, height = report["size_px"]
    return f"{width} x {height} px on {report['machine']['renderer']}, medians of {report['repeats']} turns"


def table(report: Mapping[str, Any]) -> str:
    """Lay out the times."""
    rows = [(row["attachment"], f"{row['components']}", row["into"], f"{row['ms']:.2f}") for row in report["rows"]]
    return markdown(("attachment", "components", "into", "ms"), rows, text_last=False)


@click.command()
@click.option("--width", type=click.IntRange(min=1), default=1500, show_default=True)
@click.option("--height", type=click.IntRange(min=1), default=1000, show_default=True)
@click.option("--repeats", type=click.IntRange(min=1), default=25, show_default=True, help="Turns.")
@click.option("--json", "out", type=click.Path(path_type=Path, dir_okay=False), help="Write everything here.")
def main(width: int, height: int, repeats: int, out: Path | None) -> None:
    """Measure and print."""
    report = measure(width, height, repeats)
    report["command"] = " ".join(["python", *sys.argv])
    print(f"{headline(report)}\n\n{table(report)}")
    if out is not None:
        out.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
