"""Which setting, message or module made two recorded runs differ: by executing them again, with settings of both."""
