"""The robot side of the connector: reports as values of `messages`; tasks, actions, speed limit."""
