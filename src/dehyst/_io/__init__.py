"""Files and folders: read strictly, written wholly or not at all."""
