"""A bench test of one drive while the cycle is offline: what the drive does, compared with its maker's manual."""
