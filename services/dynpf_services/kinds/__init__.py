"""The kinds of nodes of each system, and the tables that its nodes share; a node's code is loaded when it is built."""
