"""Whether this Python can run rtarm in a ROS workspace; the last line on standard error says why not."""

import importlib.util
import os
import sys

import numba  # noqa: F401
import numpy  # noqa: F401
import pydantic  # noqa: F401
import rich  # noqa: F401
import typer  # noqa: F401
import yaml  # noqa: F401

if os.environ.get("ROS_DISTRO") and importlib.util.find_spec("ros_wheels_bootstrapper"):
    sys.exit("it has ROS from wheels, which do not mix with the ROS installation that is sourced")
