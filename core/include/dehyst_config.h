/* The choices of a build, which every file of it includes. */
#ifndef DEHYST_CONFIG_H
#define DEHYST_CONFIG_H

/* The number type: double or float. */
#define DEHYST_REAL double

#endif
