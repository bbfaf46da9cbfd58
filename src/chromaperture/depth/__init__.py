"""From disparity to millimetres: conversion, calibration fits, chessboards, point clouds."""
