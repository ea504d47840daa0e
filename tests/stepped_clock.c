/* Preloaded into a process under test: its CLOCK_REALTIME is off by what stands in the file STEPPED_CLOCK names
 * (int64, ns), which the test may change at any time. Every other clock is left alone: the machine's own clock is never
 * touched, and nothing but this process is told another time. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static int (*real_gettime)(clockid_t, struct timespec *);
static const volatile int64_t *step_ns;

__attribute__((constructor)) static void prepare(void)
{
	real_gettime = (int (*)(clockid_t, struct timespec *))dlsym(RTLD_NEXT, "clock_gettime");
	int file = open(getenv("STEPPED_CLOCK"), O_RDONLY | O_CLOEXEC);
	void *mapped = mmap(NULL, sizeof *step_ns, PROT_READ, MAP_SHARED, file, 0);
	if (file < 0 || mapped == MAP_FAILED)
		abort();
	close(file);
	step_ns = mapped;
}

int clock_gettime(clockid_t clock, struct timespec *now)
{
	if (!real_gettime)
		prepare();
	int result = real_gettime(clock, now);
	if (result == 0 && clock == CLOCK_REALTIME) {
		int64_t ns = now->tv_nsec + *step_ns % 1000000000;
		now->tv_sec += *step_ns / 1000000000 + (ns >= 1000000000) - (ns < 0);
		now->tv_nsec = ns + (ns < 0 ? 1000000000 : 0) - (ns >= 1000000000 ? 1000000000 : 0);
	}
	return result;
}

int gettimeofday(struct timeval *restrict now, void *restrict zone)
{
	(void)zone;
	struct timespec stepped;
	int result = clock_gettime(CLOCK_REALTIME, &stepped);
	now->tv_sec = stepped.tv_sec;
	now->tv_usec = stepped.tv_nsec / 1000;
	return result;
}

time_t time(time_t *now)
{
	struct timespec stepped;
	clock_gettime(CLOCK_REALTIME, &stepped);
	if (now)
		*now = stepped.tv_sec;
	return stepped.tv_sec;
}
