// CHECK(condition) ends a test that is not true, and prints where.
#pragma once

#include <cstdio>
#include <cstdlib>

inline void check(bool holds, const char* what, const char* file, int line) {
  if (holds) return;
  std::fprintf(stderr, "%s:%d: not true: %s\n", file, line, what);
  std::exit(1);
}
#define CHECK(condition) check((condition), #condition, __FILE__, __LINE__)
