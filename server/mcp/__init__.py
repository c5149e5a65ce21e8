"""Model Context Protocol: the robot as tools for language models. The SDK is imported with the first request."""
