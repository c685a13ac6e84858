/* Replaces the file that QDLDL's build system generates; its version is not needed. */
