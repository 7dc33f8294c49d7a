"""Operations: the steps of the journey, files in and files out, for the command line and the workbench."""
