// SPZ by Niantic's own library: spz_program SPLAT.ply FILE.spz writes a file, spz_program FILE.spz decodes it twice and
// prints the processor seconds of the second time.
#include <cstdio>
#include <ctime>
#include <fstream>
#include <iterator>
#include <vector>

#include "load-spz.h"

static double processor() {
  timespec t;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return t.tv_sec + 1e-9 * t.tv_nsec;
}

int main(int count, char **words) {
  if (count == 3) {
    spz::UnpackOptions read;
    read.to = spz::CoordinateSystem::RUB;
    spz::PackOptions write;
    write.from = spz::CoordinateSystem::RUB;
    return spz::saveSpz(spz::loadSplatFromPly(words[1], read), write, words[2]) ? 0 : 1;
  }
  std::ifstream file(words[1], std::ios::binary);
  const std::vector<unsigned char> data{std::istreambuf_iterator<char>(file), {}};
  double seconds = 0;
  int points = 0;
  for (int i = 0; i < 2; i++) {
    const double before = processor();
    points = spz::loadSpz(data, {}).numPoints;
    seconds = processor() - before;
  }
  printf("%d %.6f\n", points, seconds);
}
