"""What a robot says of space: frames, and what is drawn of messages in them. Pure."""
