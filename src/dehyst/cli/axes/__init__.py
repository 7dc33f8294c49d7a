"""What commands do with several axes of an instrument, or with a stage as C."""
