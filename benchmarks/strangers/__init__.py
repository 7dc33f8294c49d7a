"""A suite of truths, protocols and disturbances that share nothing with the models: see `strangers.command`."""
