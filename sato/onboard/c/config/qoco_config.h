/* What the build system of QOCO would write. */
#ifndef QOCO_CONFIG_H
#define QOCO_CONFIG_H

/* Only what it prints asks for these, and here it prints nothing. */
#define QOCO_VERSION_MAJOR 0
#define QOCO_VERSION_MINOR 0
#define QOCO_VERSION_PATCH 0

#if defined(_WIN32)
#define IS_WINDOWS
#elif defined(__APPLE__)
#define IS_MACOS
#else
#define IS_LINUX /* any POSIX: clock_gettime is all that is asked of it */
#endif

#endif
