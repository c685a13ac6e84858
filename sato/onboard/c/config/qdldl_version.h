/* What the build system of QDLDL would write: its version, which nothing here asks for. */
