"""The actions that a vehicle can perform, one function for each; `runner.ACTIONS` lists them."""
