"""`rtarm scan`: which adapters are here, at which bit rate drives answer behind them, and an arm file for them.

Nothing that is said can move anything: drives are asked for their firmware and their settings.
"""
