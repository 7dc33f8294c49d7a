"""Output of the commands: progress, results and messages in the words of the command line."""
