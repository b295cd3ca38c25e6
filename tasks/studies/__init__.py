"""One registered function a file: what a study, a call or a page asks for."""
