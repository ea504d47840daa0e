"""The MoveIt configuration package of an arm, generated from its arm file.

`package_files` is a function from an arm to the texts of all files; `write_package` puts them into a folder. The robot
model follows from the section `kinematics`, limits and names from the rest, and nothing is set by hand in between.
"""

from rtarm.moveit.package import package_files, package_name
from rtarm.moveit.writer import Written, write_package

__all__ = ["Written", "package_files", "package_name", "write_package"]
