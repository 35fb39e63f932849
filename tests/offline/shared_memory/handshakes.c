/* A controller in C or C++: prints the memory layout, makes handshakes, counts edges until the node closes the segment. */
#include <anytime_scan_matcher/shared_memory.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#define TIMEOUT INT64_C(60000000000)
#define OFFSET(field) printf(#field " %zu\n", offsetof(struct anytime_segment, field))

static void require(int condition, const char *what, uint32_t number) {
  if (condition) return;
  fprintf(stderr, "%s (number %u)\n", what, (unsigned)number);
  exit(1);
}

static void require_ok(int status, uint32_t number) { require(status == ANYTIME_OK, anytime_message(status), number); }

static void print_layout(void) {
  printf("magic_number %llu\nversion_number %u\nsegment_size %zu\n", (unsigned long long)ANYTIME_MAGIC, ANYTIME_VERSION,
         sizeof(struct anytime_segment));
  OFFSET(version);
  OFFSET(size);
  OFFSET(owner);
  OFFSET(closed);
  OFFSET(requested);
  OFFSET(acknowledged);
  OFFSET(completed);
  OFFSET(idle);
  OFFSET(sequence);
  OFFSET(flags);
  OFFSET(number);
  OFFSET(stamp_seconds);
  OFFSET(stamp_nanoseconds);
  OFFSET(x);
  OFFSET(y);
  OFFSET(theta);
  OFFSET(position_deviation);
  OFFSET(heading_deviation);
  OFFSET(elapsed_nanoseconds);
}

/* Checks that every field is derived from the number. */
static void require_whole(const struct anytime_estimate *e) {
  const double value = e->number;
  const unsigned flags = ANYTIME_PRESENT | (e->number % 2 == 0 ? ANYTIME_MATCHED : 0) |
                         (e->number % 3 == 0 ? ANYTIME_DEADLINE_MET : 0) | (e->number % 5 == 0 ? ANYTIME_INTERRUPTED : 0);
  require(e->flags == flags, "flags", e->number);
  require(e->stamp_seconds == e->number && e->stamp_nanoseconds == e->number % 1000000000u, "stamp", e->number);
  require(fabs(e->x - value) + fabs(e->y + 2 * value) + fabs(e->theta - value - 0.5) == 0, "pose", e->number);
  require(fabs(e->position_deviation - value - 0.25) + fabs(e->heading_deviation - value - 0.75) == 0, "deviations", e->number);
  require(e->elapsed_nanoseconds == (uint64_t)e->number * 3, "elapsed", e->number);
}

int main(int argc, char **argv) {
  struct anytime_client client;
  struct anytime_estimate estimate;
  uint32_t i, before, request, seen = 0, edges = 0;
  int status;
  require(argc == 3, "usage: handshakes SEGMENT COUNT", 0);
  print_layout();
  require(anytime_open(&client, "/anytime_scan_matcher_absent") == ANYTIME_ABSENT, "a segment where there is none", 0);
  require_ok(anytime_open(&client, argv[1]), 0);
  for (i = 1; i <= (uint32_t)atoi(argv[2]); i++) {
    before = anytime_completed(&client);
    request = anytime_request(&client);
    require(request == i, "a request of somebody else", request);
    status = anytime_wait_for_answer(&client, request, TIMEOUT, &estimate);
    if (status == ANYTIME_NO_ESTIMATE && before == 0) continue;
    require_ok(status, request);
    require_whole(&estimate);
    require(estimate.number >= before, "an answer older than the request", request);
    require(__atomic_load_n(&client.segment->acknowledged, __ATOMIC_ACQUIRE) == request, "answers beyond the request", request);
  }
  printf("handshakes_done 1\n");
  fflush(stdout);
  for (;;) {
    before = seen;
    status = anytime_wait_for_completion(&client, &seen, TIMEOUT);
    edges += seen - before;
    if (status == ANYTIME_CLOSED) break;
    require_ok(status, seen);
  }
  printf("edges %u\n", (unsigned)edges);
  anytime_close(&client);
  return 0;
}
