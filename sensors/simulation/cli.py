"""`std-sim`: simulate a data set, preview a scene, photograph a mesh, print statistics."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sensors.simulation.options import (
    PRESETS,
    AssetsCommand,
    PreviewCommand,
    RunCommand,
    StatsCommand,
    TurntableOptions,
    with_preset,
)
from std_toolkit.cli.command import Command, Program, print_json


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    return PROGRAM.main(arguments)


def run(options: RunCommand) -> int:
    """Simulate scenes; 1 if one failed."""
    from msgspec.structs import replace

    from sensors.simulation.simulated_set import simulate_set

    if options.twins:
        return _twins(options)
    count = PRESETS[options.preset].scenes if options.scenes is None else options.scenes
    seeds = [
        options.seed + i
        for i in range(count)
        if int((i + 1) * options.share) > int(i * options.share)
    ]
    report = simulate_set(
        options.out,
        replace(options.options, split="test" if options.split == "test" else "train"),
        seeds,
        split=options.split,
        layouts=tuple(dict.fromkeys(options.layout)) or ("dreds",),
        cache=options.cache,
        jobs=options.jobs,
    )
    return _told(report, "scenes", len(seeds), options)


def _twins(options: RunCommand) -> int:
    """Render labelled scenes again; 1 if one failed."""
    from sensors.simulation.twins import simulate_twins

    report = simulate_twins(
        options.out,
        Path(options.options.scenes_from),
        tuple(dict.fromkeys(options.twins)),
        options.options,
        seed=options.seed,
        scenes=options.scenes,
        jobs=options.jobs,
    )
    count = len(report.results) + len(report.failed)
    return _told(report, "twins", count, options)


def _told(report: Any, what: str, count: int, options: RunCommand) -> int:
    made = sum(1 for times in report.results.values() if times.frames)
    print(
        f"{made} {what} made, {count - made - len(report.failed)} kept, "
        f"{len(report.failed)} failed; in {options.out}"
    )
    frames = sum(times.frames for times in report.results.values())
    if frames:
        total: dict[str, float] = {}
        for times in report.results.values():
            for part, seconds in times.seconds.items():
                total[part] = total.get(part, 0.0) + seconds
        shares = ", ".join(f"{part} {seconds / frames:.2f}" for part, seconds in total.items())
        print(f"seconds of a worker per frame: {sum(total.values()) / frames:.2f} ({shares})")
    return 1 if report.failed else 0


def preview(options: PreviewCommand) -> None:
    """Show a scene as a contact sheet."""
    from sensors.simulation.set_report import contact_sheet
    from sensors.simulation.simulated_set import parts_cache
    from sensors.simulation.simulator import Simulator
    from std_toolkit.io.images import write_color

    simulator = Simulator(options.options, parts_cache=parts_cache())
    world = simulator.world(options.seed, "preview")
    write_color(options.out, contact_sheet(list(simulator.frames(world))))
    for obj, drawn in zip(world.record.objects, world.draw.objects, strict=True):
        print(
            f"{obj.instance_id:3d}  {obj.category:10s} {1000 * obj.scale_m:4.0f} mm  "
            f"{obj.material_class:12s} {drawn.material.name}"
        )
    for index, (floor, light) in enumerate(zip(world.draw.floors, world.draw.light, strict=True)):
        print(f"view {index}: floor {floor.material.name}, light {light.environment}")
    print(f"surroundings: {world.draw.setting.kind}")
    print(options.out)


def stats(options: StatsCommand) -> None:
    """Print the statistics of a set."""
    from sensors.simulation.set_report import set_statistics
    from std_toolkit.io.atomic import write_bytes_atomic

    statistics = set_statistics(options.root)
    if options.json:
        print_json(statistics.document())
    else:
        print(statistics)
    if options.csv is not None:
        write_bytes_atomic(options.csv, statistics.depth.to_csv().encode())


def turntable(options: TurntableOptions) -> None:
    """Photograph a mesh on the printed board."""
    from sensors.simulation.turntable import make_turntable

    made, seconds = make_turntable(options)
    if made:
        print(f"{made} photos, {seconds / made:.1f} s each")
    print(options.out)


def assets(options: AssetsCommand) -> None:
    """List or download free environment maps and floors."""
    from sensors.assets.downloads import fetch, load_list

    found = load_list(options.list_file)
    if options.action == "list":
        for item in found:
            print(f"{item.folder:13s} {item.name:36s} {item.bytes / 1e6:6.1f} MB  {item.licence}")
        return
    made = fetch(options.out, found)
    print(f"{made} files downloaded, {len(found) - made} were there; in {options.out}")


def _command(name: str, about: str) -> Command:
    return Command(
        name=name,
        about=about,
        options=f"sensors.simulation.options:{name.capitalize()}Command",
        run=f"sensors.simulation.cli:{name}",
    )


PROGRAM = Program(
    name="std-sim",
    about="Simulate RGB-D recordings of specular, transparent and diffuse objects with an active "
    "stereo\ncamera.",
    commands=(
        _command("run", "simulate scenes (also without the word: std-sim --out DIR ...)"),
        _command("preview", "make one scene and show it as a contact sheet"),
        Command(
            name="turntable",
            about="photograph a mesh on the printed board, as std-scan reads it",
            options="sensors.simulation.options:TurntableOptions",
            run="sensors.simulation.cli:turntable",
        ),
        _command("assets", "list or download free environment maps and floors"),
        _command("stats", "categories, materials, and completeness and error of the raw depth"),
    ),
    default="run",
    rewrite=with_preset,
)

if __name__ == "__main__":
    sys.exit(main())
