"""The actions that a vehicle can perform.

Each action is a class that implements `performer.Performer`; `registry.py` lists them.
"""
