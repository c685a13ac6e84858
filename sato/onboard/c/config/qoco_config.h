/* Replaces the file that QOCO's build system generates. */
#ifndef QOCO_CONFIG_H
#define QOCO_CONFIG_H

/* QOCO needs these only for its printed output, which is switched off. */
#define QOCO_VERSION_MAJOR 0
#define QOCO_VERSION_MINOR 0
#define QOCO_VERSION_PATCH 0

#if defined(_WIN32)
#define IS_WINDOWS
#elif defined(__APPLE__)
#define IS_MACOS
#else
#define IS_LINUX /* any POSIX system: QOCO needs only clock_gettime */
#endif

#endif
