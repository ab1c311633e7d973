"""YARP's wire formats: conversion between bytes and values, without sockets and threads."""
