// SPZ by Niantic's own library, which PROGRAM SPLAT.ply FILE.spz writes, and PROGRAM FILE.spz SPLAT.ply reads.
// PROGRAM FILE.spz decodes a file twice, and prints its Gaussians and the processor seconds of the second time.
#include <cstdio>
#include <ctime>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "load-spz.h"

static double processor() {
  timespec t;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return t.tv_sec + 1e-9 * t.tv_nsec;
}

int main(int count, char **words) {
  // Files have the axes of three.js. PLY files have others, which the library turns.
  spz::UnpackOptions read;
  spz::PackOptions write;
  read.to = write.from = spz::CoordinateSystem::RUB;
  const std::string first = words[1];
  if (first.substr(first.size() - 4) == ".ply")
    return spz::saveSpz(spz::loadSplatFromPly(first, read), write, words[2]) ? 0 : 1;
  if (count == 3) return spz::saveSplatToPly(spz::loadSpz(first, read), write, words[2]) ? 0 : 1;
  std::ifstream file(first, std::ios::binary);
  const std::vector<unsigned char> data{std::istreambuf_iterator<char>(file), {}};
  double seconds = 0;
  int points = 0;
  for (int i = 0; i < 2; i++) {
    const double before = processor();
    points = spz::loadSpz(data, read).numPoints;
    seconds = processor() - before;
  }
  printf("%d %.6f\n", points, seconds);
}
