"""Disparity to millimetres: conversion, fit, boards, point cloud (paper sections 3.2 to 3.4)."""
