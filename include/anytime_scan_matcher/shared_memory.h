/* Shared memory between the scan matcher's node and a controller on the same machine. The controller can request an answer now,
 * and wait for each completed estimate. Linux; C11 or C++11, GCC or Clang. Link with -lrt if glibc is older than 2.34. Include
 * this file before any other, or define _GNU_SOURCE. The node's side, and the same layout in Rust: src/shared_memory/.
 *
 *     #include <anytime_scan_matcher/shared_memory.h>
 *     #include <stdio.h>
 *
 *     int main(void) {
 *       struct anytime_client client;
 *       struct anytime_estimate estimate;
 *       int status = anytime_open(&client, ANYTIME_DEFAULT_NAME);
 *       if (status == ANYTIME_OK) {
 *         uint32_t request = anytime_request(&client);
 *         status = anytime_wait_for_answer(&client, request, 10000000, &estimate);      // at most 10 ms
 *         if (status == ANYTIME_OK) printf("%f m %f m %f rad\n", estimate.x, estimate.y, estimate.theta);
 *         anytime_close(&client);
 *       }
 *       if (status != ANYTIME_OK) fprintf(stderr, "%s\n", anytime_message(status));
 *       return status;
 *     }
 *
 * The protocol. Requests, answers and estimates are counted. The counts wrap around, and none is ever reset. Events are detected
 * as the difference of two counts, so that none is missed by checking late, and none is seen twice.
 *   A controller adds 1 to `requested`; the sum is the number of its request. Then it reads `idle` (both sequentially
 *   consistent): if it is set, it wakes the futex `requested`.
 *   A node that processes a scan checks between iterations whether `requested` is ahead of `acknowledged`. When the estimate is
 *   complete, it writes it, adds 1 to `completed` (release), sets `idle`, then reads `requested` (both sequentially consistent),
 *   stores that as `acknowledged` (release) and wakes both futexes. An idle node, once woken, does only the last step: the answer
 *   is the newest estimate. When it begins to process a scan, it clears `idle` and does the same again: later requests are for
 *   that scan.
 *   A controller's request is answered once `acknowledged` (acquire) has reached its number. Any number of controllers may make
 *   requests.
 *   The estimate is written and read through a sequence lock. Writer: sequence + 1 (odd); release fence; fields; sequence + 1
 *   (release). Reader: sequence (acquire); fields; acquire fence; sequence again: if it is not the same even number, read again.
 *   The node holds an exclusive flock on the segment as long as it is alive; the kernel releases it however the node dies.
 *
 * Every function except anytime_open and anytime_close may be called from several threads at once. */
#ifndef ANYTIME_SCAN_MATCHER_SHARED_MEMORY_H
#define ANYTIME_SCAN_MATCHER_SHARED_MEMORY_H

#ifndef _GNU_SOURCE
#define _GNU_SOURCE
#endif

#include <errno.h>
#include <fcntl.h>
#include <linux/futex.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#ifdef __cplusplus
extern "C" {
#define ANYTIME_ASSERT(condition) static_assert(condition, #condition)
#else
#define ANYTIME_ASSERT(condition) _Static_assert(condition, #condition)
#endif

#define ANYTIME_DEFAULT_NAME "/anytime_scan_matcher"
/* "ANYTSCAN" read as a little-endian number. */
#define ANYTIME_MAGIC UINT64_C(0x4e41435354594e41)
#define ANYTIME_VERSION 1u
#define ANYTIME_SIZE 512u
/* Time for which a wait polls the memory before it sleeps, ns. */
#define ANYTIME_SPIN INT64_C(10000)
/* Period at which a sleeping controller checks that the node is alive, ns. */
#define ANYTIME_PEER_CHECK INT64_C(50000000)

/* Return values of the functions. */
enum anytime_status {
  ANYTIME_OK = 0,
  ANYTIME_NO_ESTIMATE, /* answered, but no estimate has been completed yet */
  ANYTIME_TIMED_OUT,
  ANYTIME_CLOSED,
  ANYTIME_OWNER_DIED,
  ANYTIME_HALF_WRITTEN,
  ANYTIME_ABSENT,
  ANYTIME_DENIED,
  ANYTIME_WRONG_SIZE,
  ANYTIME_WRONG_MAGIC,
  ANYTIME_WRONG_VERSION,
  ANYTIME_SYSTEM_ERROR /* see errno */
};

/* Bits of anytime_estimate.flags. */
enum anytime_flag {
  ANYTIME_PRESENT = 1,      /* there is an estimate */
  ANYTIME_MATCHED = 2,      /* the scan was matched; without it the pose is the prediction */
  ANYTIME_DEADLINE_MET = 4, /* the deadline was met */
  ANYTIME_INTERRUPTED = 8   /* a request ended the refinement early */
};

/* An estimate, with the fields of the segment after the sequence number. */
struct anytime_estimate {
  uint32_t flags;
  uint32_t number;            /* number of completed estimates including this one; its parity was icp_state's value */
  uint32_t stamp_seconds;     /* of the scan */
  uint32_t stamp_nanoseconds;
  uint32_t reserved;
  double x;                   /* position of the base in the odometry frame, m */
  double y;                   /* m */
  double theta;               /* rad, in (-pi, pi] */
  double position_deviation;  /* standard deviation, m; infinite if unknown */
  double heading_deviation;   /* standard deviation, rad; infinite if unknown */
  uint64_t elapsed_nanoseconds; /* from the scan's arrival to this estimate */
};

/* The segment. Access it only through the __atomic functions. */
struct anytime_segment {
  uint64_t magic; /* stored last: a segment with this value is completely initialized */
  uint32_t version;
  uint32_t size;
  uint32_t owner;  /* process id of the node, only for messages */
  uint32_t closed; /* 1: the node has closed the segment, there will be no more answers */
  uint8_t padding_of_identity[104];
  uint32_t requested; /* number of requests made; written by controllers; futex */
  uint8_t padding_of_controller[124];
  uint32_t acknowledged; /* number of the last answered request; earlier ones are answered, too; written by the node; futex */
  uint32_t completed;    /* number of estimates completed; parity: the topic icp_state; written by the node; futex */
  uint32_t idle;         /* 1: a request must wake the futex `requested`; written by the node */
  uint8_t padding_of_node[116];
  uint32_t sequence; /* odd while the node writes the fields below */
  uint32_t flags;
  uint32_t number;
  uint32_t stamp_seconds;
  uint32_t stamp_nanoseconds;
  uint32_t reserved;
  uint64_t x; /* bits of a double, like the next four */
  uint64_t y;
  uint64_t theta;
  uint64_t position_deviation;
  uint64_t heading_deviation;
  uint64_t elapsed_nanoseconds;
  uint8_t padding_of_estimate[56];
};

/* SYS_futex takes a timespec of two longs. */
ANYTIME_ASSERT(sizeof(time_t) == sizeof(long));
ANYTIME_ASSERT(sizeof(struct anytime_segment) == ANYTIME_SIZE);
ANYTIME_ASSERT(offsetof(struct anytime_segment, magic) == 0);
ANYTIME_ASSERT(offsetof(struct anytime_segment, version) == 8);
ANYTIME_ASSERT(offsetof(struct anytime_segment, size) == 12);
ANYTIME_ASSERT(offsetof(struct anytime_segment, owner) == 16);
ANYTIME_ASSERT(offsetof(struct anytime_segment, closed) == 20);
ANYTIME_ASSERT(offsetof(struct anytime_segment, requested) == 128);
ANYTIME_ASSERT(offsetof(struct anytime_segment, acknowledged) == 256);
ANYTIME_ASSERT(offsetof(struct anytime_segment, completed) == 260);
ANYTIME_ASSERT(offsetof(struct anytime_segment, idle) == 264);
ANYTIME_ASSERT(offsetof(struct anytime_segment, sequence) == 384);
ANYTIME_ASSERT(offsetof(struct anytime_segment, flags) == 388);
ANYTIME_ASSERT(offsetof(struct anytime_segment, number) == 392);
ANYTIME_ASSERT(offsetof(struct anytime_segment, stamp_seconds) == 396);
ANYTIME_ASSERT(offsetof(struct anytime_segment, stamp_nanoseconds) == 400);
ANYTIME_ASSERT(offsetof(struct anytime_segment, reserved) == 404);
ANYTIME_ASSERT(offsetof(struct anytime_segment, x) == 408);
ANYTIME_ASSERT(offsetof(struct anytime_segment, y) == 416);
ANYTIME_ASSERT(offsetof(struct anytime_segment, theta) == 424);
ANYTIME_ASSERT(offsetof(struct anytime_segment, position_deviation) == 432);
ANYTIME_ASSERT(offsetof(struct anytime_segment, heading_deviation) == 440);
ANYTIME_ASSERT(offsetof(struct anytime_segment, elapsed_nanoseconds) == 448);

/* A controller's access to a segment. */
struct anytime_client {
  struct anytime_segment *segment;
  int file;
};

/* Meaning of a status, and the remedy. */
static inline const char *anytime_message(int status) {
  switch (status) {
    case ANYTIME_OK: return "no error";
    case ANYTIME_NO_ESTIMATE: return "no estimate has been completed yet: wait for one";
    case ANYTIME_TIMED_OUT: return "timed out: try again, or allow more time";
    case ANYTIME_CLOSED: return "the node has closed the segment: open it again once the node has been restarted";
    case ANYTIME_OWNER_DIED: return "the node has died: open the segment again once the node has been restarted";
    case ANYTIME_HALF_WRITTEN: return "the newest estimate remains half written: the node is stopped, or gets no processor time";
    case ANYTIME_ABSENT: return "there is no such segment: start the node, and give both the same name";
    case ANYTIME_DENIED: return "the segment belongs to another user: run the node and the controller as the same user";
    case ANYTIME_WRONG_SIZE: return "wrong size of the segment: try again if the node is just starting, otherwise update both to the same version";
    case ANYTIME_WRONG_MAGIC: return "not a segment of the scan matcher: try again if the node is just starting, otherwise choose another name";
    case ANYTIME_WRONG_VERSION: return "the segment has another layout: update the node and the controller to the same version";
    default: return "error of the operating system, see errno: check that /dev/shm exists";
  }
}

/* Checks that the node still serves the segment: no one else can get the lock while it is alive. */
static inline int anytime_check_peer(const struct anytime_client *client) {
  if (__atomic_load_n(&client->segment->closed, __ATOMIC_ACQUIRE) != 0) return ANYTIME_CLOSED;
  if (flock(client->file, LOCK_SH | LOCK_NB) != 0) return ANYTIME_OK;
  flock(client->file, LOCK_UN);
  return ANYTIME_OWNER_DIED;
}

/* Releases the resources of anytime_open. */
static inline void anytime_close(struct anytime_client *client) {
  if (client->segment != NULL) munmap(client->segment, ANYTIME_SIZE);
  if (client->file >= 0) close(client->file);
  client->segment = NULL;
  client->file = -1;
}

/* Checks the size of the file and maps it. */
static inline int anytime_map(struct anytime_client *client) {
  struct stat status;
  void *start;
  if (fstat(client->file, &status) != 0) return ANYTIME_SYSTEM_ERROR;
  if (status.st_size != (off_t)ANYTIME_SIZE) return ANYTIME_WRONG_SIZE;
  start = mmap(NULL, ANYTIME_SIZE, PROT_READ | PROT_WRITE, MAP_SHARED, client->file, 0);
  if (start == MAP_FAILED) return ANYTIME_SYSTEM_ERROR;
  client->segment = (struct anytime_segment *)start;
  return ANYTIME_OK;
}

/* Checks that the segment has this layout, and that a node serves it. */
static inline int anytime_check(const struct anytime_client *client) {
  if (__atomic_load_n(&client->segment->magic, __ATOMIC_ACQUIRE) != ANYTIME_MAGIC) return ANYTIME_WRONG_MAGIC;
  if (__atomic_load_n(&client->segment->version, __ATOMIC_RELAXED) != ANYTIME_VERSION) return ANYTIME_WRONG_VERSION;
  if (__atomic_load_n(&client->segment->size, __ATOMIC_RELAXED) != ANYTIME_SIZE) return ANYTIME_WRONG_SIZE;
  return anytime_check_peer(client);
}

/* Opens the segment of a running node. On failure there is nothing to close. */
static inline int anytime_open(struct anytime_client *client, const char *name) {
  int status;
  client->segment = NULL;
  client->file = shm_open(name, O_RDWR, 0);
  if (client->file < 0) return errno == ENOENT ? ANYTIME_ABSENT : errno == EACCES ? ANYTIME_DENIED : ANYTIME_SYSTEM_ERROR;
  status = anytime_map(client);
  if (status == ANYTIME_OK) status = anytime_check(client);
  if (status != ANYTIME_OK) anytime_close(client);
  return status;
}

/* Requests an answer now. Returns the number of the request. */
static inline uint32_t anytime_request(const struct anytime_client *client) {
  uint32_t *requested = &client->segment->requested;
  uint32_t number = __atomic_add_fetch(requested, 1, __ATOMIC_SEQ_CST);
  if (__atomic_load_n(&client->segment->idle, __ATOMIC_SEQ_CST) != 0) {
    syscall(SYS_futex, requested, FUTEX_WAKE, INT32_MAX, NULL, NULL, 0);
  }
  return number;
}

/* Number of estimates completed so far; its parity is the value of the topic icp_state. */
static inline uint32_t anytime_completed(const struct anytime_client *client) {
  return __atomic_load_n(&client->segment->completed, __ATOMIC_ACQUIRE);
}

static inline int64_t anytime_now(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (int64_t)now.tv_sec * INT64_C(1000000000) + now.tv_nsec;
}

static inline void anytime_sleep(uint32_t *word, uint32_t value, int64_t nanoseconds) {
  struct timespec timeout;
  timeout.tv_sec = (time_t)(nanoseconds / INT64_C(1000000000));
  timeout.tv_nsec = (long)(nanoseconds % INT64_C(1000000000));
  syscall(SYS_futex, word, FUTEX_WAIT, value, &timeout, NULL, 0); /* the caller checks the word in any case */
}

/* Waits until *word - bound, a wrapping difference, is below 2^31. */
static inline int anytime_wait(const struct anytime_client *client, uint32_t *word, uint32_t bound, int64_t timeout_nanoseconds) {
  const int64_t start = anytime_now();
  for (;;) {
    const int64_t waited = anytime_now() - start;
    /* Checked before the word is read, so that the last count of a node that has just died is not missed. */
    const int peer = waited < ANYTIME_SPIN ? (int)ANYTIME_OK : anytime_check_peer(client);
    const uint32_t value = __atomic_load_n(word, __ATOMIC_ACQUIRE);
    const int64_t left = timeout_nanoseconds - waited;
    if (value - bound < UINT32_C(0x80000000)) return ANYTIME_OK;
    if (peer != ANYTIME_OK) return peer;
    if (left <= 0) return ANYTIME_TIMED_OUT;
    if (waited >= ANYTIME_SPIN) anytime_sleep(word, value, left < ANYTIME_PEER_CHECK ? left : ANYTIME_PEER_CHECK);
  }
}

static inline double anytime_load_double(const uint64_t *bits) {
  const uint64_t loaded = __atomic_load_n(bits, __ATOMIC_RELAXED);
  double value;
  memcpy(&value, &loaded, sizeof value);
  return value;
}

/* Tries to read the estimate once. Returns whether it is consistent: the node was not writing meanwhile. */
static inline int anytime_try_read(const struct anytime_segment *from, struct anytime_estimate *to) {
  const uint32_t before = __atomic_load_n(&from->sequence, __ATOMIC_ACQUIRE);
  to->flags = __atomic_load_n(&from->flags, __ATOMIC_RELAXED);
  to->number = __atomic_load_n(&from->number, __ATOMIC_RELAXED);
  to->stamp_seconds = __atomic_load_n(&from->stamp_seconds, __ATOMIC_RELAXED);
  to->stamp_nanoseconds = __atomic_load_n(&from->stamp_nanoseconds, __ATOMIC_RELAXED);
  to->reserved = 0;
  to->x = anytime_load_double(&from->x);
  to->y = anytime_load_double(&from->y);
  to->theta = anytime_load_double(&from->theta);
  to->position_deviation = anytime_load_double(&from->position_deviation);
  to->heading_deviation = anytime_load_double(&from->heading_deviation);
  to->elapsed_nanoseconds = __atomic_load_n(&from->elapsed_nanoseconds, __ATOMIC_RELAXED);
  __atomic_thread_fence(__ATOMIC_ACQUIRE);
  return before % 2 == 0 && __atomic_load_n(&from->sequence, __ATOMIC_RELAXED) == before;
}

/* Reads the newest estimate. Gives up after some 60 ms if the node does not finish writing. */
static inline int anytime_read_newest(const struct anytime_client *client, struct anytime_estimate *estimate) {
  const struct timespec pause = {0, 100000};
  int attempt, peer;
  for (attempt = 0; attempt < 600; attempt++) {
    if (anytime_try_read(client->segment, estimate)) {
      return (estimate->flags & ANYTIME_PRESENT) != 0 ? ANYTIME_OK : ANYTIME_NO_ESTIMATE;
    }
    if (attempt >= 100) nanosleep(&pause, NULL);
  }
  peer = anytime_check_peer(client);
  return peer != ANYTIME_OK ? peer : (int)ANYTIME_HALF_WRITTEN;
}

/* Waits for the answer to a request and reads it: the newest estimate, completed before the answer was given. Zeros
 * if there is none. */
static inline int anytime_wait_for_answer(
    const struct anytime_client *client, uint32_t request, int64_t timeout_nanoseconds, struct anytime_estimate *estimate) {
  const int status = anytime_wait(client, &client->segment->acknowledged, request, timeout_nanoseconds);
  memset(estimate, 0, sizeof *estimate);
  return status != ANYTIME_OK ? status : anytime_read_newest(client, estimate);
}

/* Waits until the count of completed estimates exceeds *completed, and sets *completed to it. The wrapping difference of the
 * two is the number of estimates completed since; none is missed, however late this is called. */
static inline int anytime_wait_for_completion(const struct anytime_client *client, uint32_t *completed, int64_t timeout_nanoseconds) {
  const int status = anytime_wait(client, &client->segment->completed, *completed + 1, timeout_nanoseconds);
  if (status == ANYTIME_OK) *completed = anytime_completed(client);
  return status;
}

#ifdef __cplusplus
}
#endif

#endif
