"""`rtarm scan`: which adapters are here, at which bit rate drives answer behind them, and an arm file for them.

Nothing that is said can move a drive that rtarm knows: drives are asked who they are and how they are set.
"""
