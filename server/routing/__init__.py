"""From a path to a resource, and from a method to what the resource does."""
