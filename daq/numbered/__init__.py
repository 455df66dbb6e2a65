"""Places of a sender's messages in its count."""
