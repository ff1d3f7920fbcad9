"""Programs that measurements start beside the agent and the floors."""
