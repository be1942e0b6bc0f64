"""A prompt for SelectScript and SQL in a terminal, `ssduck shell`, and magics in notebooks."""
