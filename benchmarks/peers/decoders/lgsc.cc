// L-GSC by Qualcomm's own library, which PROGRAM SPLAT.ply FILE.lgsc writes at the highest compression level, and
// PROGRAM FILE.lgsc SPLAT.ply reads. PROGRAM FILE.lgsc is as in spz.cc.
#include <cstdio>
#include <ctime>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "LGSCCommon.h"
#include "LGSCDecoder.h"
#include "LGSCEncoder.h"

static double processor() {
  timespec t;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return t.tv_sec + 1e-9 * t.tv_nsec;
}

int main(int count, char **words) {
  const std::string first = words[1];
  std::ifstream file(first, std::ios::binary);
  if (first.substr(first.size() - 4) == ".ply") {
    GS gs;
    std::vector<char> data;
    if (!readFile(first, gs)) return 1;
    compressFrame(gs, data, 2);
    std::ofstream(words[2], std::ios::binary).write(data.data(), data.size());
    return 0;
  }
  std::vector<char> data{std::istreambuf_iterator<char>(file), {}};
  if (count == 3) {
    GS gs;
    decompressFrame(data, gs);
    return writeFile(words[2], gs) ? 0 : 1;
  }
  double seconds = 0;
  int points = 0;
  for (int i = 0; i < 2; i++) {
    std::vector<float> positions, rotations, scales, opacities, diffuse, specular;
    const double before = processor();
    decompressFrame(data, points, positions, rotations, scales, opacities, diffuse, specular);
    seconds = processor() - before;
  }
  printf("%d %.6f\n", points, seconds);
}
