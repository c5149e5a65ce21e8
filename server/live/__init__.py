"""Live values: subscriptions on demand, views of topics, and folding."""
