"""SGPA: priors adapted by the structure of the object that is seen (Chen and Dou, ICCV 2021)."""
