# Writes the sources of the core as one file, dehyst.c: what an export copies and the Python package compiles.
#
#     cmake -D CORE=<this folder> -D OUT=<folder> -D SOURCES=<sources in order> -P amalgamate.cmake
#
# The text depends on the sources alone. Private headers are put in once, where they are first included.
function(without_includes text result)
  string(REGEX REPLACE "#include \"internal\\.h\"\n+" "" text "${text}")
  set(${result} "${text}" PARENT_SCOPE)
endfunction()

set(text "/* The core of dehyst in one file, put together from core/src. Do not edit. */\n")
foreach(source internal.h ${SOURCES})
  file(READ "${CORE}/src/${source}" part)
  without_includes("${part}" part)
  string(APPEND text "\n/* ${source} */\n${part}")
endforeach()
file(WRITE "${OUT}/dehyst.c" "${text}")
