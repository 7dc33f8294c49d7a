/* The settings of a build; all files of the build include them. */
#ifndef DEHYST_CONFIG_H
#define DEHYST_CONFIG_H

/* The number type: double or float. */
#define DEHYST_REAL double

#endif
