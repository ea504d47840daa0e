"""The command line. Everything heavy is imported inside the command that needs it, so that help is quick.

Here is what concerns a whole arm; a file beside this one has each other group of commands.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rtarm.cli import completion
from rtarm.cli.calibrate import calibrate_app
from rtarm.cli.commission import commission_app
from rtarm.cli.drives import drives_app
from rtarm.cli.frame import (
    ArmArgument,
    AsJson,
    LanguageOption,
    NamedArm,
    RunningArm,
    again,
    app,
    config_app,
    draw,
    draw_json,
    one_arm,
    overrides_given,
    sentences,
)
from rtarm.cli.motions import motions_app
from rtarm.cli.orders import orders
from rtarm.cli.recordings import recordings_app
from rtarm.cli.view import view_app
from rtarm.cli.why_late import why_late_app
from rtarm.console.errors import ExitCode, Refusal

if TYPE_CHECKING:
    from rtarm.console.reporter import Reporter


SIMULATED_ARM_HELP = "Name or file of the arm to simulate; left out: episode1."


def _show_version(wanted: bool) -> None:
    if not wanted:
        return
    from importlib.metadata import PackageNotFoundError, version

    try:
        typer.echo(f"rtarm {version('rtarm')}")
    except PackageNotFoundError:
        typer.echo("rtarm (not installed, run from its source folder)")
    raise typer.Exit


@app.callback()
def main(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_show_version, help="Show the version.")
    ] = False,
) -> None:
    """Options of `rtarm` itself."""


@app.command()
def up(
    arm: ArmArgument,
    sim: Annotated[bool, typer.Option("--sim", help="Simulate the drives; no hardware is opened.")] = False,
    hand: Annotated[
        str | None,
        typer.Option(
            metavar="MOTION", help="With --sim: a hand that leads the arm whenever it is limp (`wave`, or a CSV file)."
        ),
    ] = None,
    interface: Annotated[
        str | None,
        typer.Option(help="How the bus is reached (slcan, seeedstudio, ch340-at, socketcan, python-can, mock)."),
    ] = None,
    channel: Annotated[
        str | None, typer.Option(help="Device of the CAN adapter (/dev/ttyACM0) or CAN interface (can0).")
    ] = None,
    rate: Annotated[float | None, typer.Option(metavar="HZ", help="Control rate (Hz).")] = None,
    init_mode: Annotated[
        int | None,
        typer.Option(metavar="0|1", help="1: take over the pose the arm stands in; 0: run homing."),
    ] = None,
    clear_fault: Annotated[
        bool,
        typer.Option("--clear-fault", help="Clear what a drive has tripped at before, once its cause is removed."),
    ] = False,
    view: Annotated[bool, typer.Option("--view", help="Serve its page too, as `rtarm view` does.")] = False,
) -> None:
    """Start an arm: control process and ROS process, and with --sim the simulated drives.

    Runs until Ctrl-C, which stops the arm on its path first. A dead ROS process is started again; when the
    control process ends by itself, everything ends with exit code 3 and nothing is started again.

    Example: [bold]rtarm up episode1 --interface slcan --channel /dev/ttyACM0[/bold]
    """
    with sentences():
        from rtarm.launch.plan import load_plan
        from rtarm.launch.up import up as run

        if sim and (interface is not None or channel is not None):
            raise Refusal(
                "--sim brings its own adapter, so --interface and --channel cannot be given with it: leave "
                "out either --sim or those two."
            )
        if hand is not None and not sim:
            raise Refusal("--hand is the hand of a simulated arm: give --sim with it, or lead the real arm yourself.")
        overrides = overrides_given(
            {
                "bus": {"interface": interface, "channel": channel},
                "control": {"rate_hz": rate, "init_mode": init_mode},
            }
        )
        plan = load_plan(arm, overrides, simulated=sim, again=again(), hand=hand, view=view, clear_fault=clear_fault)
        raise typer.Exit(run(plan, _reporter()))


@app.command()
def demo(
    arm: Annotated[
        str | None,
        typer.Argument(metavar="ARM", help=SIMULATED_ARM_HELP, callback=one_arm, autocompletion=completion.known_arms),
    ] = None,
    named: Annotated[
        str | None,
        typer.Option(
            "--arm",
            "-a",
            metavar="ARM",
            help=SIMULATED_ARM_HELP,
            is_eager=True,
            autocompletion=completion.known_arms,
        ),
    ] = None,
    goal: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Recorded FollowJointTrajectory goal (JSON); left out: a tour of four."),
    ] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write all figures to this file.")
    ] = None,
    view: Annotated[
        bool, typer.Option("--view", help="Serve the arm's page, and keep the arm to be moved from it until Ctrl-C.")
    ] = False,
) -> None:
    """Play goals that MoveIt planned on a simulated arm, and show how well it followed them.

    Starts the simulated drives, the control process, the ROS process and an action client of its own, in a
    ROS domain and namespace of their own. The exit code is 0 only if every goal succeeded. With --view the goals begin
    as soon as a browser shows the page, or after half a minute.

    Example: [bold]rtarm demo --view[/bold]
    """
    with sentences():
        from rtarm.demo.run import run_demo

        raise typer.Exit(run_demo(arm or "episode1", goal, json_file, _reporter(), view=view))


@app.command()
def status(
    arm: RunningArm = None,
    named: NamedArm = None,
    as_json: AsJson = False,
    language: LanguageOption = "en",
) -> None:
    """Show what a running arm does, from its shared memory alone.

    The exit code is 0 when it is running and healthy: holding, executing or stopping, no latched fault, all
    joints referenced, and a living ROS process.

    Example: [bold]rtarm status --json[/bold]
    """
    with sentences({"arm": arm, "running": False, "healthy": False} if as_json else None, language):
        from rtarm.console.language import language_of
        from rtarm.running.status import read_status, resolve_arm
        from rtarm.running.status_tables import render_status

        spoken = "en" if as_json else language_of(language)
        report = read_status(resolve_arm(arm, spoken), spoken)
        if as_json:
            draw_json(report)
        else:
            draw(render_status(report, spoken))
        raise typer.Exit(int(ExitCode.DONE if report["healthy"] else ExitCode.UNHEALTHY))


@app.command()
def top(
    arm: RunningArm = None,
    named: NamedArm = None,
    why: Annotated[
        bool, typer.Option("--why", help="Tell what late cycles waited for, from the kernel's trace (as root).")
    ] = False,
    language: LanguageOption = "en",
) -> None:
    """Show live what a running arm does, until q or Ctrl-C.

    Mode, goal, joints, lateness and cycle time of the last seconds and since the start, bus load, and what happened,
    from its shared memory alone. Without a terminal use `rtarm status --json`.

    Example: [bold]rtarm top episode1[/bold]
    """
    with sentences(language=language):
        from rtarm.console.language import language_of
        from rtarm.running.status import resolve_arm
        from rtarm.top.terminal import run

        spoken = language_of(language)
        found = resolve_arm(arm, spoken)
        if not why:
            run(found, spoken)
            return
        from rtarm.why_late.live import live

        with live(found, spoken) as told:
            run(found, spoken, told)


@app.command()
def doctor(
    arm: Annotated[
        str | None,
        typer.Argument(metavar="ARM", help="Name or file of the arm to run here; left out: this machine alone."),
    ] = None,
    as_json: AsJson = False,
    fix: Annotated[
        bool, typer.Option("--fix", help="Set what a reboot brings back by itself (as root), and say how to undo it.")
    ] = False,
) -> None:
    """Look for what makes control cycles late or the bus slow here, and say what mends it.

    The exit code is 0 when nothing is worse than a note. Without --fix nothing is changed.

    Example: [bold]rtarm doctor episode1[/bold]
    """
    with sentences({"healthy": False} if as_json else None):
        from config.loader import load_arm
        from rtarm.console.reporter import LastingConsole
        from rtarm.doctor.machine import Machine
        from rtarm.doctor.report import examine, show

        report = examine(Machine(), None if arm is None else load_arm(arm), fix=fix)
        if as_json:
            draw_json(report)
        else:
            show(report, LastingConsole(highlight=False, emoji=False))
        raise typer.Exit(int(ExitCode.DONE if report["healthy"] else ExitCode.UNHEALTHY))


@app.command()
def bench(
    quick: Annotated[bool, typer.Option("--quick", help="Under a minute, at 1 kHz, instead of twenty.")] = False,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write all figures to this file.")
    ] = None,
    plot_file: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE", help="Draw the tails (.png, .svg or .pdf).")
    ] = None,
    why: Annotated[bool, typer.Option("--why", help="Name what kept rtarm's late cycles waiting (as root).")] = False,
) -> None:
    """Measure how late control cycles wake up on this machine, beside cyclictest and beside plain Python drivers.

    Everybody has the same slices in turn, idle and under load; the machine should have nothing else to do. Ctrl-C ends
    it early and shows what was measured until then.

    Example: [bold]rtarm bench --quick --json figures.json[/bold]
    """
    with sentences():
        from rtarm.bench.run import FULL, QUICK, run_bench

        raise typer.Exit(run_bench(QUICK if quick else FULL, json_file, plot_file, _reporter(), why=why))


@config_app.command("check")
def config_check(arm: ArmArgument, as_json: AsJson = False) -> None:
    """Check an arm file and print what follows from it: limits, resolution, bus load, highest rate.

    Example: [bold]rtarm config check ./my_arm.yaml[/bold]
    """
    with sentences({"arm": arm, "fits": False} if as_json else None):
        from config.budget import check_budget
        from config.check import figures, render_check
        from config.loader import load_arm

        loaded = load_arm(arm)
        if as_json:
            check_budget(loaded)
            draw_json({**figures(loaded), "fits": True})
        else:
            draw(render_check(loaded))
            check_budget(loaded)


@app.command("moveit-config")
def moveit_config(
    arm: ArmArgument,
    output: Annotated[
        str, typer.Option("-o", "--output", metavar="DIR", help="Existing folder, such as src of a colcon workspace.")
    ],
    force: Annotated[bool, typer.Option("--force", help="Also replace generated files that you changed.")] = False,
) -> None:
    """Generate the MoveIt configuration package of an arm, or bring the one that is there up to date.

    Writes DIR/<arm>_moveit_config: robot model, collision pairs, limits, controllers, launch files. Files of your own
    in it stay as they are, and so do generated ones that you changed: then nothing is written, unless with --force.

    Example: [bold]rtarm moveit-config ./my_arm.yaml -o ~/ros2_ws/src[/bold]
    """
    with sentences():
        from config.loader import load_arm
        from rtarm.moveit import write_package

        if not output:  # a shell variable that is not set, rather than the folder one happens to stand in
            raise Refusal(
                "-o names no folder: give an existing one, such as the src of a colcon workspace, or . for here."
            )
        typer.echo(str(write_package(load_arm(arm), Path(output), force=force)))


def _reporter() -> Reporter:
    from rtarm.console.reporter import LastingConsole, Reporter

    return Reporter(LastingConsole(highlight=False, emoji=False))


app.add_typer(recordings_app)
app.add_typer(orders)
app.add_typer(drives_app)
app.add_typer(calibrate_app)
app.add_typer(commission_app)
app.add_typer(view_app)
app.add_typer(motions_app)
app.add_typer(why_late_app)

__all__ = ["app"]
