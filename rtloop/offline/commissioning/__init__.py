"""A bench test of one drive beside an offline cycle: what it does, beside what its maker's manual says."""
