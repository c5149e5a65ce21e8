"""The ROS vocabulary, and pure functions that lift ROS into RDF and lower RDF back into ROS."""
