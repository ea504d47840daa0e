"""`python -m rtarm` is `rtarm`."""

from rtarm.cli import app

app(prog_name="rtarm")
