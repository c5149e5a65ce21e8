"""Adapters: where robots are reached. `base.py` is their contract, each folder one kind of ROS system."""
