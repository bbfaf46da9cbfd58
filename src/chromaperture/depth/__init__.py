"""Disparity to millimetres: conversion, depth fields, point cloud (paper sections 3.2 to 3.4)."""
