"""What an arm is: the schema, the YAML arm files, and every figure that follows from them.

This package imports nothing else of rtarm. `loader.load_arm` is the one way from a name or a file to
a validated, frozen `schema.ArmConfig`; `budget.check_budget` then says whether the bus can carry it.

Nothing is imported here: who needs a figure of `stopping` does not wait for the schema.
"""
