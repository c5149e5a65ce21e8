"""Framework of resources: requests, the base class of resources, representations and problems."""
