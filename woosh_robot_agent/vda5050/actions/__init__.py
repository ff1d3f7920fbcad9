"""The actions that a vehicle can perform, each a function; `runner.ACTIONS` lists them."""
