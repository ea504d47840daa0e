"""A plugin of pytest for runs that judge mutants: quick to fail, the same every time, without what compiles for long.

The cache of compiled code is named by a hash of all sources, so each mutant would have to compile everything anew;
whoever runs with this plugin sees to it that what does depend on an edited file is compiled again.
"""

from typing import Any, NoReturn

import pytest
from hypothesis import Phase, settings

from compilation import cache

cache.key = lambda: "mutants"  # type: ignore[assignment]


def skip(*_: Any, **__: Any) -> NoReturn:
    pytest.skip("goes through the whole cycle, which takes a minute to compile")


@pytest.hookimpl(trylast=True)
def pytest_configure() -> None:
    """What was found need not be made small, nor kept."""
    phases = (Phase.explicit, Phase.generate)
    settings.register_profile("mutants", deadline=None, database=None, derandomize=True, phases=phases)
    settings.load_profile("mutants")
    import virtual

    from rtloop import cycle  # what these compile goes into the folder that has been named by now

    cycle.step = skip
    virtual.VirtualArm.__new__ = skip  # none is made, so none is to be closed
