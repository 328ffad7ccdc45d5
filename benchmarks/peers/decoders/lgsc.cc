// L-GSC by Qualcomm's own library: lgsc_program SPLAT.ply FILE.lgsc writes a file at the highest compression level,
// lgsc_program FILE.lgsc decodes it twice and prints the processor seconds of the second time.
#include <cstdio>
#include <ctime>
#include <fstream>
#include <iterator>
#include <sstream>
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
  if (count == 3) {
    GS gs;
    std::vector<char> data;
    if (!readFile(words[1], gs)) return 1;
    compressFrame(gs, data, 2);
    std::ofstream(words[2], std::ios::binary).write(data.data(), data.size());
    return 0;
  }
  std::ifstream file(words[1], std::ios::binary);
  std::vector<char> data{std::istreambuf_iterator<char>(file), {}};
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
