"""The framework of resources: requests, the contract of a resource, representations, problems."""
