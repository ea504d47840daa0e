"""Commands about adapters and drives, for which no control process runs."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from rtarm.cli.frame import ArmArgument, AsJson, draw, draw_json, overrides_given, sentences
from rtarm.console.errors import ExitCode, Refusal

drives_app = typer.Typer()
"""The commands, for `application` to add."""


@drives_app.command()
def drives(
    arm: ArmArgument,
    write: Annotated[
        bool, typer.Option("--write", help="Write what differs to the drives' volatile memory, and read it back.")
    ] = False,
    store: Annotated[bool, typer.Option("--store", help="With --write: to their flash too, after a question.")] = False,
    interface: Annotated[
        str | None, typer.Option(help="How the bus is reached (slcan, seeedstudio, ch340-at, socketcan, python-can).")
    ] = None,
    channel: Annotated[
        str | None, typer.Option(help="Device of the CAN adapter (/dev/ttyACM0) or CAN interface (can0).")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Show the settings of every drive beside those the arm file names; write them only when told.

    Nothing moves. Refused while the arm runs. The exit code is 0 when every drive is as the file wants it.

    Example: [bold]rtarm drives ./my_arm.yaml --write[/bold]
    """
    with sentences({"arm": arm, "agrees": False} if as_json else None):
        from config.loader import load_arm
        from rtarm.drives.settings import agrees, render, run

        if store and not write:
            raise Refusal("--store writes flash, and only what --write writes: give both, or neither.")
        overrides = overrides_given({"bus": {"interface": interface, "channel": channel}})
        loaded = load_arm(arm, overrides=overrides)

        def show(report: dict[str, Any]) -> None:
            if as_json:
                draw_json({"arm": loaded.name, "agrees": agrees(report), **report})
            else:
                draw(render(loaded, report))

        report = run(
            loaded,
            arm,
            overrides,
            write=write,
            store=store,
            show=show,
            told=lambda line: typer.echo(line, err=True),
            confirm=lambda question: typer.confirm(question, err=True),
        )
        failure = report.get("failure")
        if failure:
            typer.echo(failure, err=True)
        raise typer.Exit(int(ExitCode.DONE if agrees(report) and not failure else ExitCode.UNHEALTHY))


@drives_app.command()
def scan(
    port: Annotated[
        list[str] | None,
        typer.Option(
            "--port", metavar="PATH", help="Serial port (/dev/ttyUSB0) or CAN interface (can0) to look at; repeatable."
        ),
    ] = None,
    family: Annotated[
        str | None,
        typer.Option(
            "--family",
            metavar="NAME",
            help="Ask drives of this family alone (myactuator, mks …); only where the bus has no others.",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Find CAN adapters, the bit rate of the bus behind each, and the drives on it; propose an arm file.

    No drive that rtarm knows moves: ZDT and RobStride drives are asked what they are, ODrives, VESCs and CANopen drives
    are overheard. What MyActuator, MKS, Damiao and silent VESC and CANopen drives are asked might mean something else
    to others, so they are asked with --family only. Take a VESC of number 0 with firmware from before 2019 off the bus
    first: to it a question can be a current. Adapters that another program uses are left alone, and so are serial ports
    that may be anything, unless --port names them. The exit code is 0 when a drive answers.

    Example: [bold]rtarm scan --port /dev/ttyUSB0[/bold]
    """
    with sentences({"found": False} if as_json else None):
        from rtarm.doctor.machine import Machine
        from rtarm.scan.run import scan as look
        from rtarm.scan.show import render

        report = look(Machine(), port or [], family=family, telling=lambda line: typer.echo(line, err=True))
        if as_json:
            draw_json(report)
        else:
            draw(render(report))
            typer.echo(report["proposal"] or "", nl=False)
        raise typer.Exit(int(ExitCode.DONE if report["found"] else ExitCode.UNHEALTHY))
