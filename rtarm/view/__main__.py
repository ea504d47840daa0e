"""`python -m rtarm.view ARM [--set section.key=value]... [--namespace /NAME]`: the page beside an arm's processes.

Prints `ready URL` when the page can be opened, and `opened` whenever a browser shows it. Ends with SIGTERM or SIGINT;
exit code 1 with a sentence where there can be no page.
"""

from __future__ import annotations

import argparse
import sys

from config.errors import ConfigError
from config.loader import load_arm, parse_overrides
from rtarm.console.errors import Refusal
from rtarm.view.gate import open_server
from rtarm.view.orders import Orders
from rtarm.view.run import serve
from rtarm.view.source import LiveArm
from rtarm.view.words import ENGLISH
from shm.errors import SharedMemoryError


def main(arguments: list[str] | None = None) -> int:
    """Serve the page; returns its exit code."""
    parser = argparse.ArgumentParser(prog="python -m rtarm.view", description="The page of a running arm.")
    parser.add_argument("arm", help="name of an arm, or path of its YAML file")
    parser.add_argument("--set", action="append", default=[], metavar="SECTION.KEY=VALUE", help="change a setting")
    parser.add_argument("--namespace", default="", metavar="/NAME", help="where ROS has its action")
    options = parser.parse_args(arguments)
    try:
        arm = load_arm(options.arm, overrides=parse_overrides(options.set))
        source = LiveArm(arm)
        page = open_server()
    except (ConfigError, SharedMemoryError, Refusal) as error:
        print(error, file=sys.stderr)
        return 1
    page.server.on_client_connect(lambda _: print("opened", flush=True))
    print("ready", page.url, flush=True)
    serve(page.server, arm, source, Orders(arm, ENGLISH, options.namespace), ENGLISH)
    return 0


if __name__ == "__main__":
    sys.exit(main())
