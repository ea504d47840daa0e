"""`python processor.py FILE`: what compilers must know of the processor that runs this."""

import json
import sys
from pathlib import Path

import llvmlite.binding as llvm

found = json.dumps([llvm.get_host_cpu_name(), dict(llvm.get_host_cpu_features())])
target = Path(sys.argv[1])
aside = target.with_suffix(".new")
aside.write_text(found, encoding="utf-8")
aside.replace(target)
