"""`lmeasure program`: the tests of ISO 9283 in a robot's work space, as a program."""

from pathlib import Path
from typing import Annotated

import typer

BOX = "start:stop of the box that the robot's program uses most, mm"


def program(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for program.toml, commands.csv and robodk.csv.")],
    zone: Annotated[
        Path | None, typer.Option("--zone", metavar="FILE.nc", help="Take the largest cube in this accuracy zone instead of a box.")
    ] = None,
    x: Annotated[str | None, typer.Option("--x", help=BOX)] = None,
    y: Annotated[str | None, typer.Option("--y", help=BOX)] = None,
    z: Annotated[str | None, typer.Option("--z", help=BOX)] = None,
    plane: Annotated[str, typer.Option("--plane", help="Diagonal plane of the cube that holds P1 to P5 and the paths.")] = "C1-C2-C7-C8",
    quaternion: Annotated[
        str, typer.Option("--quaternion", metavar="x,y,z,w", help="Orientation of the tool, base_from_tool.")
    ] = "0,0,0,1",
    tests: Annotated[
        str,
        typer.Option(
            "--tests", help="Which: pose, approach, stabilisation, drift, path, reorientation, posing, compliance, weaving; or all."
        ),
    ] = "pose,approach,stabilisation,path,reorientation",
    speed: Annotated[float, typer.Option("--speed", help="Rated speed between poses, mm/s.")] = 1000.0,
    path_speed: Annotated[float, typer.Option("--path-speed", help="Rated speed on paths, mm/s.")] = 500.0,
    speeds: Annotated[
        str, typer.Option("--speeds", help="Of the rated speeds, percent; the first is that of all other tests.")
    ] = "100,50,10",
    loads: Annotated[str, typer.Option("--loads", help="Loads of pose and path tests, kg; the first is that of all other tests.")] = "0",
    cycles: Annotated[
        str | None,
        typer.Option("--cycles", metavar="TEST=N,...", help="Other numbers of cycles than the standard's (pose=30, path=10, ...)."),
    ] = None,
    dwell: Annotated[float, typer.Option("--dwell", help="Rest at a pose that is measured, s.")] = 1.5,
    angles: Annotated[
        str | None, typer.Option("--angles", help="Convention in which angles are certified one by one; the rig's by default.")
    ] = None,
    limit_band: Annotated[
        float, typer.Option("--limit-band", help="Within which of a pose the robot has arrived, for stabilisation and posing time, mm.")
    ] = 0.1,
    ran: Annotated[
        Path | None,
        typer.Option(
            "--ran", metavar="TRAJECTORY", help="Only fill in when the robot ran the program.toml and commands.csv that --out holds."
        ),
    ] = None,
    loaded: Annotated[
        Path | None,
        typer.Option("--loaded", metavar="FILE.csv", help="With --ran: start_s, end_s of each force of the compliance test, in order."),
    ] = None,
    drift_hours: Annotated[float, typer.Option("--drift-hours", help="How long the drift test lasts.")] = 8.0,
) -> None:
    """Write the test program of ISO 9283: poses and paths of the cube, with cycles, speeds and loads."""
    box = [v for v in (x, y, z) if v is not None]
    if ran is not None:
        if box or zone is not None:
            raise typer.BadParameter("fills in the program that --out holds; it makes no other", param_hint="--ran")
        _fill_in(out, ran, loaded)
        return
    if loaded is not None:
        raise typer.BadParameter("goes with --ran", param_hint="--loaded")
    from lmeasure.certification.campaign import TESTS, Tests, campaign, duration_s
    from lmeasure.certification.command_files import write_campaign
    from lmeasure.certification.cube import cube_in_zone, largest_cube

    if (zone is None) == (len(box) == 0) or len(box) not in {0, 3}:
        raise typer.BadParameter("give the box by --x, --y and --z, or --zone", param_hint="--x, --y, --z")
    if zone is not None:
        cube = cube_in_zone(zone, plane)
    else:
        edges = [_numbers(v, ":", f"--{name}", 2) for v, name in zip(box, "xyz", strict=True)]
        cube = largest_cube([e[0] for e in edges], [e[1] for e in edges], plane)
    turn = _numbers(quaternion, ",", "--quaternion", 4)
    chosen = Tests(
        tests=TESTS if tests == "all" else tuple(t.strip() for t in tests.split(",")),
        quaternion=(turn[0], turn[1], turn[2], turn[3]),
        speed_mm_s=speed,
        path_speed_mm_s=path_speed,
        speeds_percent=tuple(_numbers(speeds, ",", "--speeds")),
        loads_kg=tuple(_numbers(loads, ",", "--loads")),
        dwell_s=dwell,
        cycles=_cycles(cycles),
        drift_s=3600.0 * drift_hours,
        limit_band_mm=limit_band,
        angles=angles,
    )
    plan = campaign(cube, chosen)
    write_campaign(out, plan)
    centre = ", ".join(f"{v:g}" for v in cube.centre)
    typer.echo(f"cube of {cube.edge_mm:g} mm about ({centre}) mm, plane {cube.plane}")
    typer.echo(
        f"{len(plan.program.pose)} poses, {len(plan.program.path)} paths, {len(plan.commands)} commands: {duration_s(plan) / 60.0:.0f} min"
    )
    typer.echo(f"program.toml, commands.csv and robodk.csv are in {out}")


def _fill_in(folder: Path, ran: Path, loaded: Path | None) -> None:
    from lmeasure.certification.ran import windows_from_rests
    from lmeasure.program import read_program, write_program
    from lmeasure.trajectory import read_trajectory

    written = folder / "program.toml"
    program = windows_from_rests(read_program(written), folder / "commands.csv", read_trajectory(ran), loaded=loaded)
    write_program(written, program)
    windows = [p.windows_s for p in program.pose] + [p.windows_s for p in program.path]
    windows += [p.windows_s for p in program.posing] + [c.windows_s for c in program.compliance]
    count = sum(map(len, windows))
    typer.echo(f"{count} windows filled in: {written}")


def _numbers(text: str, between: str, option: str, count: int | None = None) -> list[float]:
    try:
        values = [float(v) for v in text.split(between)]
    except ValueError:
        values = []
    if not values or (count is not None and len(values) != count):
        raise typer.BadParameter(f"{text!r}: must be {count or 'some'} numbers with {between!r} between", param_hint=option)
    return values


def _cycles(text: str | None) -> dict[str, int]:
    out = {}
    for part in text.split(",") if text else []:
        name, _, number = part.partition("=")
        if not number.strip().isdigit():
            raise typer.BadParameter(f"{part!r}: must be TEST=N, such as pose=30", param_hint="--cycles")
        out[name.strip()] = int(number)
    return out
